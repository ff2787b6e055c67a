"""What a kernel takes for granted of its params, checked where they enter.

Above one edge and below another exclude each other where the edges do not cross: "right and not
left" is then "right", and each reading is compared twice less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.compile.graph import Node
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats


class Edge(NamedTuple):
    """A param, its negative, or a constant.

    Attributes:
        param: which one; None for a constant.
        factor: of the param, or the constant itself.
    """

    param: int | None
    factor: float

    def value(self, params: Floats, own: tuple[int, ...], rows: Floats) -> Floats:
        """Return its number in each lane, or the one of all lanes."""
        if self.param is None:
            return np.array([self.factor])
        if self.param in own:
            return np.asarray(self.factor * rows[:, own.index(self.param)])
        return np.asarray(self.factor * params[[self.param]])


class Promise(NamedTuple):
    """That one edge is not above another."""

    low: Edge
    high: Edge

    @property
    def is_evident(self) -> bool:
        """Return whether it is kept by numbers, or by -a and a of a threshold a."""
        low, high = self
        if low.param is None and high.param is None:
            return low.factor <= high.factor
        return low.param == high.param and low.factor == -high.factor == -1.0

    @property
    def is_open(self) -> bool:
        """Return whether params decide it."""
        return self.low.param is not None or self.high.param is not None


def read_promises(numbers: list[list[tuple[int | None, float]]]) -> tuple[Promise, ...]:
    """Return promises that were kept as lists."""
    return tuple(Promise(Edge(*low), Edge(*high)) for low, high in numbers)


def edge(node: Node) -> Edge | None:
    """What a node is, if it is an edge."""
    if node.value is not None:
        return Edge(None, node.value)
    if node.op == "input" and node.text.startswith("p"):
        return Edge(int(node.text[1:]), 1.0)
    if node.op != "neg":
        return None
    inner = edge(node.args[0])
    return None if inner is None else inner._replace(factor=-inner.factor)


def apart(more: Node, less: Node) -> Promise | None:
    """Return the promise under which high < y and y < low exclude each other; None if they are
    others.
    """
    if more.op != "lt" or less.op != "lt" or more.args[1] is not less.args[0]:
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
