"""Statistics of a column of independent runs, each with the interval that covers its true value with probability LEVEL.

None of them takes the column to be Gaussian. What each interval is, and for which samples it holds: docs/ensemble.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.support.arrays import Floats

LEVEL: Final = 0.95
QUANTILES: Final = {"p5": 0.05, "median": 0.5, "p95": 0.95, "p99": 0.99}
GROUPS: Final = 20  # of the jackknife


class Interval(NamedTuple):
    """An estimate and the interval around it; an infinite end is one that the runs do not bound."""

    value: float
    low: float
    high: float


class Extreme(NamedTuple):
    """The least or largest of the runs, and the share of all runs that lies beyond it, at most."""

    value: float
    beyond: float


def describe(column: Floats) -> dict[str, Interval | Extreme]:
    """Mean, standard deviation, QUANTILES, min and max of at least one number; infinite ones (no mean) are allowed, NaN is not."""
    ordered = np.sort(column)
    found: dict[str, Interval | Extreme] = {"mean": mean(ordered), "std": deviation(ordered)}
    found |= {name: quantile(ordered, share) for name, share in QUANTILES.items()}
    beyond = float(-np.expm1(np.log(1 - LEVEL) / ordered.size))
    return found | {
        "min": Extreme(float(ordered[0]), beyond),
        "max": Extreme(float(ordered[-1]), beyond),
    }


def quantile(ordered: Floats, share: float) -> Interval:
    """The quantile of a sorted column, itself one of the runs, between order statistics: how many runs lie below it is binomial."""
    n = ordered.size
    low, high = (binomial(n, share, level) for level in ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return Interval(
        float(ordered[max(int(np.ceil(n * share)) - 1, 0)]),
        float(ordered[low - 1]) if low > 0 else -np.inf,
        float(ordered[high]) if high < n else np.inf,
    )


def binomial(n: int, share: float, level: float) -> int:
    """The least k such that at most k of n runs have a property of that share with probability `level`, or more."""
    from scipy.special import bdtr, bdtrik

    k = max(int(np.ceil(bdtrik(level, n, share))), 0)
    return k - 1 if k > 0 and bdtr(k - 1, n, share) >= level else k


def mean(column: Floats) -> Interval:
    """The mean, with Student's interval."""
    if not np.isfinite(column[[0, -1]]).all():
        return Interval(np.nan, np.nan, np.nan)
    value = float(np.mean(column))
    half = (
        float(student(column.size - 1) * np.std(column, ddof=1) / np.sqrt(column.size))
        if column.size > 1
        else np.inf
    )
    return Interval(value, value - half, value + half)


def deviation(column: Floats) -> Interval:
    """The standard deviation; the interval of its logarithm takes the kurtosis from the runs."""
    n = column.size
    if n < 2 or not np.isfinite(column[[0, -1]]).all():
        return Interval(np.nan, np.nan, np.nan)
    value = float(np.std(column, ddof=1))
    if value == 0:
        return Interval(0.0, 0.0, 0.0)
    kurtosis = float(np.mean(((column - np.mean(column)) / value) ** 4))
    factor = float(np.exp(student(n - 1) * np.sqrt(max(kurtosis - (n - 3) / (n - 1), 0.0) / n) / 2))
    return Interval(value, value / factor, value * factor)


def proportion(count: int, runs: int) -> Interval:
    """The share of runs with a property, between Clopper and Pearson's exact bounds."""
    from scipy.special import betaincinv

    low = float(betaincinv(count, runs - count + 1, (1 - LEVEL) / 2)) if count > 0 else 0.0
    high = float(betaincinv(count + 1, runs - count, (1 + LEVEL) / 2)) if count < runs else 1.0
    return Interval(count / runs, low, high)


def jackknife(estimate: Callable[[Any], Floats], rows: int) -> Floats:
    """The standard error of estimate(mask of rows), by leaving out one of GROUPS groups of rows at a time."""
    group = np.arange(rows) % GROUPS
    left_out = np.stack([estimate(group != g) for g in range(GROUPS)])
    return np.sqrt((GROUPS - 1) * left_out.var(axis=0))


def student(freedom: int) -> float:
    """Half the width of the interval in standard errors."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, (1 + LEVEL) / 2))
