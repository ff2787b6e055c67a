"""Sums of normalised innovations: too large where something lasts that nobody claimed.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

FAR = 4.5  # standard deviations beyond which an innovation says nothing of a constant


class Sums(NamedTuple):
    """What is kept of innovations.

    Attributes:
        total: fading sum of the normalised innovations.
        count: what its variance is if the claims are true.
        ratio: slow mean of total^2 / count, 1 if the claims are true.
    """

    total: Any
    count: Any
    ratio: Any


def summed(before: Sums, nu: Any, counted: Any, fade: Any, keep: Any) -> Sums:
    """The sums after one more sample.

    Args:
        before: the sums before it.
        nu: normalised innovations, 0 where none counts.
        counted: whether one counts.
        fade: share of the sum that is left after a step.
        keep: share of the mean of its squares that is left after a step.
    """
    total = fade * before.total + nu
    count = fade**2 * before.count + counted
    square = total**2 / ca.fmax(count, 1.0)
    ratio = ca.if_else(count > 1, keep * before.ratio + (1 - keep) * square, before.ratio)
    return Sums(total, count, ratio)
