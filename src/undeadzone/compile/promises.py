"""What a kernel takes for granted of its params, checked where they enter.

Above one edge and below another exclude each other where the edges do not cross: "right and not
left" is then "right", and each reading is compared twice less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.compile.ops import Op
from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats


class Edge(NamedTuple):
    """A param, its negative, or a constant.

    Attributes:
        param: which one; None for a constant.
        factor: of the param, or the constant itself.
    """

    param: int | None
    factor: float

    def value(self, params: Floats, own: tuple[int, ...], rows: Floats) -> Floats:
        """Its number in each lane, or the one of all lanes."""
        if self.param is None:
            return np.array([self.factor])
        if self.param in own:
            return np.asarray(self.factor * rows[:, own.index(self.param)])
        return np.asarray(self.factor * params[[self.param]])


class Promise(NamedTuple):
    """That one edge is not above another."""

    low: Edge
    high: Edge


def read(numbers: list[list[tuple[int | None, float]]]) -> tuple[Promise, ...]:
    """Promises that were kept as lists."""
    return tuple(Promise(Edge(*low), Edge(*high)) for low, high in numbers)


def edge(op: Op) -> Edge | None:
    """What an instruction is, if it is an edge."""
    if op.kind == "const":
        return Edge(None, _number(op.text))
    if op.kind == "input" and op.text.startswith("p"):
        return Edge(int(op.text[1:]), 1.0)
    if op.kind != "fneg":
        return None
    inner = edge(op.args[0])
    return None if inner is None else inner._replace(factor=-inner.factor)


def apart(more: Op, less: Op) -> Promise | None:
    """The promise under which high < y and y < low exclude each other; None if they are others."""
    if more.kind != "fcmp olt" or less.kind != "fcmp olt" or more.args[1] is not less.args[0]:
        return None
    high, low = edge(more.args[0]), edge(less.args[1])
    return None if high is None or low is None else Promise(low, high)


def require(
    promises: tuple[Promise, ...], params: Floats, own: tuple[int, ...], rows: Floats
) -> None:
    """Check what a kernel takes for granted.

    Args:
        promises: of the kernel.
        params: p.
        own: entries of p that differ by lane.
        rows: those of each lane (lanes x own).

    Raises:
        InputError: a promise is broken.
    """
    for promise in promises:
        low, high = (edge.value(params, own, rows) for edge in promise)
        crossed = low > high
        if crossed.any():
            lane = int(np.argmax(crossed))
            right, left = (float(np.resize(edges, lane + 1)[-1]) for edges in (high, low))
            raise InputError(
                f"params: lane {lane}: expected edges of a zone that do not cross, "
                f"found the right one at {right:g} and the left one at {left:g}"
            )


def _number(text: str) -> float:
    """A constant of LLVM's text."""
    return float(np.array([int(text, 16)], np.uint64).view(np.float64)[0])
