"""The edges of a jump sensor, whose readings are z itself beyond them: order statistics.

No reading lies between 0 and an edge, and the least one lies just beyond it: by an exponential
number whose rate is the density of readings there. A jump sensor less its edges is a dead zone of
known widths, so the plant is found as behind any other zone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.objective import Limits
from undeadzone.identification.options import Options
from undeadzone.identification.plant_fit import Data
from undeadzone.support.arrays import Floats

NEAREST = 20  # passages of an edge whose least readings tell the density there
FEWEST = 4
SURE = 0.05  # probability that the edge lies below its interval
SUREST = 0.001  # and below the range that an observer is told


class JumpEdge(NamedTuple):
    """An edge of a jump sensor.

    Attributes:
        value, low, high: the edge with its 95 % interval.
        lowest: the low end of its 99.9 % interval, whose high end is the same.
    """

    value: float
    low: float
    high: float
    lowest: float


def as_dead_zone(data: Data, options: Options) -> tuple[Data, Limits, tuple[JumpEdge, JumpEdge]]:
    """The readings of a jump sensor less its edges, as a dead zone of known widths gives them.

    Args:
        data: records, scaled, with exact zeros.
        options: what the user said; known edges are taken as they are.

    Returns:
        The records, limits that hold the edges, and the edges with 95 % intervals, scaled.

    Raises:
        InputError: there are no exact zeros, an edge is hardly passed, or a given one contradicts
            the readings.
    """
    if not data.silent_zeros:
        raise InputError(
            "kind: a jump sensor is silent inside its zone, and these readings have no exact zeros;"
            " give --threshold, |y| up to which a reading counts as silent"
        )
    edges = []
    for name, sign in (("right", 1), ("left", -1)):
        edges.append(_edge(data, sign, name, options))
    right, left = edges
    shift = right.value * (data.side > 0) - left.value * (data.side < 0)
    limits = Limits((right.value, right.value), (left.value, left.value))
    return data._replace(y=(data.y - shift) * (data.side != 0)), limits, (right, left)


def _edge(data: Data, sign: int, name: str, options: Options) -> JumpEdge:
    """An edge with its intervals, scaled. Raises InputError."""
    least = _least_by_passage(data, sign)
    low, high = options.bounds("right" if sign > 0 else "left")
    if low == high and math.isfinite(low):
        known = low / data.y_scale
        if least.size and least[0] < known * (1 - 1e-9):
            raise InputError(
                f"{name}: {low:g} is given, but a reading of {least[0] * data.y_scale:.6g} lies"
                " below it"
            )
        return JumpEdge(known, known, known, known)
    if least.size < FEWEST:
        raise InputError(
            f"log: the {name} edge of the jump sensor is passed {least.size} times, and"
            f" {FEWEST} are needed; record for longer, or give --{name}"
        )
    return edge_of(least)


def edge_of(least: Floats) -> JumpEdge:
    """The edge below the least readings of several passages.

    With k of them evenly spread above the edge d, (k - 1) / (x_k - x_1) is the density, and x_1 - d
    over their spread has the distribution of a ratio of gamma variables: F with 2 and 2 (k - 1)
    degrees of freedom.

    Args:
        least: least reading of each passage, sorted (at least 2).

    Returns:
        The edge without bias, and its intervals, which end at the least reading.
    """
    from scipy.stats import f

    used = least[: min(NEAREST, max(FEWEST, least.size // 4))]
    k = used.size
    gap = float(used[-1] - used[0]) / (k - 1)  # mean spacing: x_1 - d is one more
    first = float(used[0])
    low, lowest = first - gap * f.ppf(1 - np.array([SURE, SUREST]), 2, 2 * (k - 1))
    return JumpEdge(first - gap, float(low), first, float(lowest))


def _least_by_passage(data: Data, sign: int) -> Floats:
    """The least |reading| of each passage of an edge, sorted; one visit has two ends."""
    beyond = data.ok & (data.side == sign)
    ends = np.diff(np.concatenate([[0], beyond.astype(int), [0]]))
    first, last = np.flatnonzero(ends == 1), np.flatnonzero(ends == -1) - 1
    size = np.abs(data.y)
    return np.sort(np.concatenate([size[first], size[last[last > first]]]))
