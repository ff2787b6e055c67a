"""Intervals of fitted numbers.

The deviation of a number is the larger one of two: that of the information, and that of the scores
summed over blocks of readings. The latter includes the error of the filter's approximation in
silence, which lasts for many readings. A number at an end of its range, or one that the logs hardly
determine, has the interval in which the likelihood is within 1.92 of its maximum while the others
stay.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Flags, Floats
from undeadzone.util.text import HALF_95
from undeadzone_identify.fitting.problem import FitProblem
from undeadzone_identify.fitting.search import (
    AT_END,
    LARGEST_DIFFERENCE,
    Slope,
    diagonal_of,
    measure_slope,
    root_of_inverse,
)

BLOCKS: Final = (60, 20)  # of a log, over each of which scores are summed
SHORTEST: Final = 5  # readings of a block
SMALLEST: Final = 1e-6  # difference, in ranges
SHARES: Final = (0.001, 0.02, 0.3)  # differences, in deviations
DROP: Final = HALF_95**2 / 2  # of the log likelihood at the ends of an interval
WIDE: Final = 0.5  # share of its range from which an interval shows nothing
POINTS: Final = 41  # of a scan of a range
LINKED: Final = 0.98  # correlation from which two numbers are known together alone


class Intervals(NamedTuple):
    """Intervals of fitted numbers.

    Attributes:
        low, high: ends of the 95 % intervals (k).
        std: standard deviations in coordinates (k), 0 at an end of a range.
        correlations: of the numbers (k x k).
        directions: in columns, the combinations of numbers in deviations of their own, from the
            least known one on (k x k).
        shown: whether the interval is narrower than half of the range (k).
    """

    low: Floats
    high: Floats
    std: Floats
    correlations: Floats
    directions: Floats
    shown: Flags


def estimate_intervals(problem: FitProblem, point: Floats, value: float) -> Intervals:
    """Return the intervals at the maximum of a likelihood.

    Args:
        problem: the numbers.
        point: the maximum, in coordinates (k).
        value: log likelihood there.
    """
    low, high = problem.low, problem.high
    span = high - low
    slope = _measure_smooth_slope(problem, point)
    at_end = (point <= low + AT_END * span) | (point >= high - AT_END * span)
    free = np.flatnonzero(~at_end)
    inside = np.ix_(free, free)
    cov = np.zeros((point.size, point.size))
    units = 1 / np.sqrt(diagonal_of(problem, slope.information)[free])
    root = root_of_inverse(slope.information[inside], units)
    cov[inside] = root @ root.T
    variance = np.diag(cov).copy()
    for blocks in BLOCKS:
        wide = cov[inside] @ _sum_block_scores(slope.scores[free], blocks) @ cov[inside]
        variance[free] = np.maximum(variance[free], np.diag(wide))
    std = np.hypot(np.sqrt(variance), problem.measure_blur(point))
    ends = np.stack([point - HALF_95 * std, point + HALF_95 * std])
    ends = np.clip(ends, low, high)
    scale = np.sqrt(np.maximum(np.diag(cov), 1e-300))
    correlations = cov / np.outer(scale, scale)
    linked = np.abs(correlations - np.diag(np.diag(correlations))).max(axis=0) > LINKED
    for i in map(int, np.flatnonzero(at_end | ((ends[1] - ends[0] > WIDE * span) & ~linked))):
        ends[:, i] = _scan_range(problem, point, value, i)
    values = problem.decode_points(ends)
    ranges = problem.decode_points(np.stack([low, high]))
    narrow = np.diff(values, axis=0)[0] < WIDE * np.diff(ranges, axis=0)[0]
    _, directions = np.linalg.eigh(-correlations)
    return Intervals(values[0], values[1], std, correlations, directions, narrow)


def _measure_smooth_slope(problem: FitProblem, point: Floats) -> Slope:
    """Return the derivatives at a point (k), by that difference of each number which shows least.

    Over some differences a contact changes. The jump there would pass for knowledge.
    """
    span = problem.high - problem.low
    first = measure_slope(problem, point, SMALLEST * span)
    units = 1 / np.sqrt(diagonal_of(problem, first.information))
    steps = np.minimum(np.outer(SHARES, units), LARGEST_DIFFERENCE * span)
    steps = np.vstack([steps, -steps])
    known = [np.diag(measure_slope(problem, point, each).information) for each in steps]
    return measure_slope(problem, point, np.choose(np.argmin(known, axis=0), steps))


def _sum_block_scores(scores: Floats, blocks: int) -> Floats:
    """Return the covariance of the sum of scores (k x readings), from sums over blocks (k x k)."""
    length = max(SHORTEST, -(-scores.shape[1] // blocks))
    starts = np.arange(0, scores.shape[1], length)
    sums = np.add.reduceat(scores, starts, axis=1)
    off = sums - sums.mean(axis=1, keepdims=True)
    return off @ off.T * len(starts) / max(1, len(starts) - 1)


def _scan_range(problem: FitProblem, point: Floats, value: float, i: int) -> tuple[float, float]:
    """Return the ends, in coordinates, between which the likelihood is near its maximum.

    The other numbers stay.
    """
    low, high = problem.low[i], problem.high[i]
    near = np.geomspace(1e-6, 1.0, POINTS) * (high - low)
    steps = np.concatenate([np.linspace(low, high, POINTS), point[i] - near, point[i] + near])
    places = np.unique(np.clip(steps, low, high))
    points = np.tile(point, (places.size, 1))
    points[:, i] = places
    good = problem.evaluate_points(points) > value - DROP
    good |= places == point[i]
    return float(places[good].min()), float(places[good].max())
