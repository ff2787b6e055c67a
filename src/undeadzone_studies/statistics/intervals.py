"""Statistics of a column of independent runs, each with an interval of confidence LEVEL.

They do not assume a Gaussian column. docs/ensemble.md defines each interval, and the samples for
which it holds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats, Integers

LEVEL: Final = 0.95
QUANTILES: Final = {"p5": 0.05, "median": 0.5, "p95": 0.95, "p99": 0.99}
GROUPS: Final = 20  # of the jackknife


class Interval(NamedTuple):
    """Estimate and the interval that covers the true value with probability LEVEL.

    Attributes:
        value: the estimate.
        low, high: the ends of the interval (infinite if the runs do not bound it).
    """

    value: float
    low: float
    high: float


class Extreme(NamedTuple):
    """Least or largest value of the runs.

    Attributes:
        value: the number.
        beyond: the share of all possible runs that lies beyond it, at most.
    """

    value: float
    beyond: float


def describe(column: Floats) -> dict[str, Interval | Extreme]:
    """Describe a column of runs: mean, standard deviation, QUANTILES, min and max.

    Args:
        column: one number or more (infinite ones are allowed, which have no mean, but not NaN).
    """
    ordered = np.sort(column)
    statistics: dict[str, Interval | Extreme] = {
        "mean": mean_interval(ordered),
        "std": deviation_interval(ordered),
    }
    for name, share in QUANTILES.items():
        statistics[name] = quantile_interval(ordered, share)
    beyond = float(-np.expm1(np.log(1 - LEVEL) / ordered.size))
    statistics["min"] = Extreme(float(ordered[0]), beyond)
    statistics["max"] = Extreme(float(ordered[-1]), beyond)
    return statistics


def quantile_interval(ordered: Floats, share: float) -> Interval:
    """Return a quantile of a column, itself a run, with an interval between two runs.

    The interval rests on order statistics: how many runs lie below the true quantile is binomial.

    Args:
        ordered: the column, sorted.
        share: the part of all runs that lies below the quantile, 0.5 for the median.
    """
    n = ordered.size
    below = binomial_quantile(n, share, (1 - LEVEL) / 2)
    above = binomial_quantile(n, share, (1 + LEVEL) / 2)
    value = float(ordered[max(int(np.ceil(n * share)) - 1, 0)])
    low = float(ordered[below - 1]) if below > 0 else -np.inf
    high = float(ordered[above]) if above < n else np.inf
    return Interval(value, low, high)


def binomial_quantile(n: int, share: float, level: float) -> int:
    """Return the quantile of the binomial distribution.

    It is the least k such that at most k of n runs have a property of that share with probability
    `level`, or more.
    """
    from scipy.special import bdtr, bdtrik

    k = max(int(np.ceil(bdtrik(level, n, share))), 0)
    one_too_many = k > 0 and bdtr(k - 1, n, share) >= level
    return k - 1 if one_too_many else k


def mean_interval(column: Floats) -> Interval:
    """Return the mean of a sorted column, with Student's interval."""
    if not np.isfinite(column[[0, -1]]).all():
        return Interval(np.nan, np.nan, np.nan)
    value = float(np.mean(column))
    if column.size == 1:
        return Interval(value, -np.inf, np.inf)
    half = float(
        student_half_width(column.size - 1) * np.std(column, ddof=1) / np.sqrt(column.size)
    )
    return Interval(value, value - half, value + half)


def deviation_interval(column: Floats) -> Interval:
    """Return the standard deviation of a sorted column, with its interval.

    The interval is that of its logarithm, with the kurtosis of the runs.
    """
    n = column.size
    if n < 2 or not np.isfinite(column[[0, -1]]).all():
        return Interval(np.nan, np.nan, np.nan)
    value = float(np.std(column, ddof=1))
    if value == 0:
        return Interval(0.0, 0.0, 0.0)
    kurtosis = float(np.mean(((column - np.mean(column)) / value) ** 4))
    variance = max(kurtosis - (n - 3) / (n - 1), 0.0) / n  # of 2 log(value)
    factor = float(np.exp(student_half_width(n - 1) * np.sqrt(variance) / 2))
    return Interval(value, value / factor, value * factor)


def proportion(count: int, runs: int) -> Interval:
    """Return the share of runs with a property, between Clopper and Pearson's exact bounds."""
    (low,), (high,) = share_bounds(np.array([count]), runs)
    return Interval(count / runs, float(low), float(high))


def share_bounds(counts: Integers, runs: int) -> tuple[Floats, Floats]:
    """Return Clopper and Pearson's bounds (lower, upper) of the shares of runs with
    properties.

    Args:
        counts: how many runs have each property.
        runs: how many there are.
    """
    from scipy.special import betaincinv

    low = betaincinv(np.maximum(counts, 1), runs - counts + 1, (1 - LEVEL) / 2)
    high = betaincinv(counts + 1, np.maximum(runs - counts, 1), (1 + LEVEL) / 2)
    return np.where(counts > 0, low, 0.0), np.where(counts < runs, high, 1.0)


def jackknife_error(estimate: Callable[[Any], Floats], rows: int) -> Floats:
    """Return the standard error of an estimate, leaving out each of GROUPS groups of rows in
    turn.

    Args:
        estimate: takes a mask of the rows to use.
        rows: number of rows.
    """
    group = np.arange(rows) % GROUPS
    left_out = np.stack([estimate(group != g) for g in range(GROUPS)])
    return np.sqrt((GROUPS - 1) * left_out.var(axis=0))


def student_half_width(freedom: int) -> float:
    """Return half the width of Student's interval for these degrees of freedom [standard
    errors].
    """
    from scipy.special import stdtrit

    return float(stdtrit(freedom, (1 + LEVEL) / 2))
