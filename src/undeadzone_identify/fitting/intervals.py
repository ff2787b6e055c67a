"""Intervals of fitted numbers.

The deviation of a number is the larger one of two: that of the information, and that of the slow
cosines of the scores. The latter includes the error of the filter's approximation in
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
from undeadzone_identify.fitting.search import AT_END, DIFFERENCE, choose_steps, measure_slope
from undeadzone_identify.models.estimates import decompose_scaled, long_run_covariance

SLOW: Final = 20  # cosines of the scores, whose mean square is the variance of their sum
APART: Final = 0.3  # of a difference, in deviations: over a jump where a contact closes
LEAST: Final = 1e-10  # eigenvalue of an information, over that of 1, that counts
DROP: Final = HALF_95**2 / 2  # of the log likelihood at the ends of an interval
WIDE: Final = 0.5  # share of its range from which an interval shows nothing
POINTS: Final = 41  # of a scan of a range
LINKED: Final = 0.98  # correlation from which two numbers are known together alone


class Intervals(NamedTuple):
    """Intervals of fitted numbers.

    Attributes:
        low, high: ends of the 95 % intervals (k).
        std: standard deviations in coordinates (k), about 0 at an end of a range.
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
    low, high, span = problem.low, problem.high, problem.span
    steps = 1e-6 * span
    for share in (DIFFERENCE, DIFFERENCE, APART):
        slope = measure_slope(problem, point, steps)
        steps = choose_steps(problem, slope.information, share)
    at_end = np.minimum(point - low, high - point) <= AT_END * span
    fixed = AT_END**-1 * at_end * np.diag(slope.information)
    certain = slope.information + np.diag(fixed + 1e-12 / span**2)
    units, values, vectors = decompose_scaled(certain)
    root = units[:, None] * vectors / np.sqrt(np.maximum(values, LEAST))
    cov = root @ root.T
    summed, _ = long_run_covariance(slope.scores.T, SLOW)
    std = np.sqrt(np.maximum(np.diag(cov), np.diag(cov @ summed @ cov)))
    ends = np.clip(point + np.outer([-HALF_95, HALF_95], std), low, high)
    scale = np.sqrt(np.diag(cov))
    correlations = cov / np.outer(scale, scale)
    linked = np.abs(correlations - np.eye(point.size)).max(axis=0) > LINKED
    for i in map(int, np.flatnonzero(at_end | ((ends[1] - ends[0] > WIDE * span) & ~linked))):
        ends[:, i] = _scan_range(problem, point, value, i)
    values = problem.decode_points(ends)
    ranges = problem.decode_points(np.stack([low, high]))
    narrow = np.diff(values, axis=0)[0] < WIDE * np.diff(ranges, axis=0)[0]
    _, directions = np.linalg.eigh(-correlations)
    return Intervals(values[0], values[1], std, correlations, directions, narrow)


def _scan_range(problem: FitProblem, point: Floats, value: float, i: int) -> tuple[float, float]:
    """Return the ends, in coordinates, between which the likelihood is near its maximum.

    The other numbers stay.
    """
    low, high = problem.low[i], problem.high[i]
    near = np.geomspace(1e-6, 1.0, POINTS) * problem.span[i]
    places = np.unique(np.clip(point[i] + np.outer([-1.0, 0.0, 1.0], near), low, high))
    points = np.tile(point, (places.size, 1))
    points[:, i] = places
    good = problem.evaluate_points(points) > value - DROP
    good |= places == point[i]
    return float(places[good].min()), float(places[good].max())
