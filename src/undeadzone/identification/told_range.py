"""The ranges of the widths that an observer is told: the shown intervals at 99.9 %."""

from __future__ import annotations

import math
from typing import Literal

from undeadzone.errors import InputError
from undeadzone.identification.answer import Answer
from undeadzone.identification.element import Element
from undeadzone.identification.intervals import Interval
from undeadzone.identification.long_run import quantile

SURE = 0.999  # level of the ranges
LEAST = 1e-6  # of a width, by which its range is wide at least


def told_range(answer: Answer, side: Literal["right", "left"]) -> tuple[float, float]:
    """The 99.9 % interval of a width, within the bounds that the user gave [y].

    Each half of the shown interval grows as Student's quantile does for the degrees of freedom that
    it has, which are few where the edge is passed a few times; an edge of a jump sensor has
    quantiles of its own.

    Args:
        answer: with both widths.
        side: right or left.

    Returns:
        The least and the largest width.

    Raises:
        InputError: the width has no upper bound.
    """
    edge = answer.right if side == "right" else answer.left
    assert isinstance(edge, Interval)
    low, high = answer.options.bounds(side)
    below, above = _reach(answer, side, edge)
    low, high = max(edge.value - below, low, 0.0), min(edge.value + above, high)
    if not math.isfinite(high):
        raise InputError(
            f"scenario: the log gives no upper bound of d_{side}; bound it by --{side} LOW,HIGH"
        )
    margin = LEAST * max(high, LEAST)
    return (low, high) if high - low > margin else (max(low - margin, 0.0), high + margin)


def told_element(element: Element, interval: Interval) -> tuple[float, float]:
    """The 99.9 % interval of a width of an element that is no dead zone, not below 0 [y]."""
    wider = quantile(element.degrees, SURE) / quantile(element.degrees)
    low = max(interval.value - wider * (interval.value - interval.low), 0.0)
    high = interval.value + wider * (interval.high - interval.value)
    margin = LEAST * max(high, LEAST)
    return (low, high) if high - low > margin else (max(low - margin, 0.0), high + margin)


def _reach(answer: Answer, side: str, edge: Interval) -> tuple[float, float]:
    """How far the range goes below and above a width [y]."""
    below, above = edge.value - edge.low, edge.high - edge.value
    jumps = answer.evidence.jumps
    if jumps is not None:
        jump = jumps[0] if side == "right" else jumps[1]
        return below + (jump.low - jump.lowest) * answer.scale, above
    degrees = answer.evidence.widths.degrees[side]
    if answer.element is not None:
        degrees = answer.element.degrees
    wider = quantile(degrees, SURE) / quantile(degrees)
    return wider * below, wider * above
