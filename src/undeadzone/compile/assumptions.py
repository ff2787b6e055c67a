"""Assumptions of a kernel about its params, checked when the params enter.

Above one edge and below another exclude each other if the edges do not cross: "right and not left"
is then "right", and each reading is compared twice less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.compile.graph import Node
from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats


class ParamBreakpoint(NamedTuple):
    """Breakpoint that is a param, its negative, or a constant.

    Attributes:
        param: index of the param (None for a constant).
        factor: of the param, or the constant itself.
    """

    param: int | None
    factor: float

    def lane_values(self, params: Floats, own: tuple[int, ...], rows: Floats) -> Floats:
        """Return the breakpoint in each lane (lanes), or a single number shared by all
        lanes (1).
        """
        if self.param is None:
            return np.array([self.factor])
        if self.param in own:
            return np.asarray(self.factor * rows[:, own.index(self.param)])
        return np.asarray(self.factor * params[[self.param]])


class KernelAssumption(NamedTuple):
    """Assumption that the breakpoint `low` is not above the breakpoint `high`."""

    low: ParamBreakpoint
    high: ParamBreakpoint

    @property
    def is_evident(self) -> bool:
        """Return whether the assumption holds for all params: by its numbers, or for -a
        and a of a threshold a.
        """
        low, high = self
        if low.param is None and high.param is None:
            return low.factor <= high.factor
        return low.param == high.param and low.factor == -high.factor == -1.0

    @property
    def is_open(self) -> bool:
        """Return whether the assumption depends on params."""
        return self.low.param is not None or self.high.param is not None


def read_assumptions(numbers: list[list[tuple[int | None, float]]]) -> tuple[KernelAssumption, ...]:
    """Return assumptions from pairs of breakpoints, each [place of a param or None, offset]."""
    return tuple(
        KernelAssumption(ParamBreakpoint(*low), ParamBreakpoint(*high)) for low, high in numbers
    )


def to_breakpoint(node: Node) -> ParamBreakpoint | None:
    """Return a node as a breakpoint, or None if it is not a param or a constant."""
    if node.constant_value is not None:
        return ParamBreakpoint(None, node.constant_value)
    if node.op == "input" and node.text.startswith("p"):
        return ParamBreakpoint(int(node.text[1:]), 1.0)
    if node.op != "neg":
        return None
    inner = to_breakpoint(node.args[0])
    return None if inner is None else inner._replace(factor=-inner.factor)


def exclusion_assumption(more: Node, less: Node) -> KernelAssumption | None:
    """Return the assumption under which high < y and y < low exclude each other, else None.

    None means that the two comparisons are of a different form.
    """
    if more.op != "lt" or less.op != "lt" or more.args[1] is not less.args[0]:
        return None
    high = to_breakpoint(more.args[0])
    low = to_breakpoint(less.args[1])
    return None if high is None or low is None else KernelAssumption(low, high)


def require_assumptions(
    promises: tuple[KernelAssumption, ...], params: Floats, own: tuple[int, ...], rows: Floats
) -> None:
    """Raise InputError unless all assumptions of a kernel hold for its params.

    Args:
        promises: of the kernel.
        params: p.
        own: entries of p that differ by lane.
        rows: those of each lane (lanes x own).

    Raises:
        InputError: a promise is broken.
    """
    for promise in promises:
        low, high = (edge.lane_values(params, own, rows) for edge in promise)
        crossed = low > high
        if crossed.any():
            lane = int(np.argmax(crossed))
            right, left = (float(np.resize(edges, lane + 1)[-1]) for edges in (high, low))
            raise InputError(
                f"params: lane {lane}: expected edges of a zone that do not cross, "
                f"found the right one at {right:g} and the left one at {left:g}"
            )
