"""Sensitivity of a metric to varied entries: rank correlations and Sobol indices.

They are estimated from given runs, after Plischke, Borgonovo and Smith 2013, or from the runs of
Saltelli's design, Saltelli et al. 2010. X (runs x entries) and y (runs) are finite numbers.

References:
    A. Saltelli and others (2010), doi:10.1016/j.cpc.2009.09.018
    E. Plischke, E. Borgonovo, C. L. Smith (2013), doi:10.1016/j.ejor.2012.11.047
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats, Integers
from undeadzone_studies.statistics.intervals import (
    GROUPS,
    LEVEL,
    Interval,
    jackknife_error,
    student_half_width,
)

LEAST: Final = 2 * GROUPS  # runs, below which there is no result
PERMUTATIONS: Final = 200


class Correlation(NamedTuple):
    """Rank correlation with its interval.

    Attributes:
        value: the correlation, between -1 and 1.
        low, high: the interval of confidence LEVEL.
        p: the probability of one as large if there were none.
    """

    value: float
    low: float
    high: float
    p: float


class Sensitivity(NamedTuple):
    """Dependence of a metric on a single varied entry.

    Attributes:
        spearman: rank correlation.
        partial: partial rank correlation, the other entries being held.
        first_order: first-order Sobol index, from the design if it is Saltelli's, else from the
            runs as they are.
        floor: first_order that chance alone reaches once in twenty (None under Saltelli's design).
        total_order: total Sobol index (None but under Saltelli's design).
    """

    spearman: Correlation
    partial: Correlation
    first_order: Interval
    floor: float | None
    total_order: Interval | None = None


class SobolIndices(NamedTuple):
    """Sobol indices of an entry from Saltelli's design.

    Attributes:
        first: the share of the variance that it causes alone.
        total: the same with everything that it interacts with.
    """

    first: Interval
    total: Interval


def sensitivities_of_runs(X: Floats, y: Floats) -> list[Sensitivity]:
    """Return the dependence of y on each entry, from runs without a design.

    Args:
        X: the varied entries (runs x entries).
        y: the metric (runs).

    Returns:
        One per entry, none for fewer than LEAST runs, or if all of y are alike.
    """
    n, d = X.shape
    if n < max(LEAST, d + 4) or np.ptp(y) == 0:
        return []

    def estimate(rows: Floats) -> Floats:
        """Return Spearman's, partial, first order (3 x entries) from some of the runs."""
        return np.stack(
            [*rank_correlations(X[rows], y[rows]), first_order_indices(X[rows], y[rows])]
        )

    spearman, partial, first = estimate(np.full(n, True))
    errors = student_half_width(GROUPS - 1) * jackknife_error(estimate, n)
    floor = first_order_by_chance(y)
    entries = []
    for i in range(d):
        alone = _correlation_interval(spearman[i], errors[0, i], n - 2)
        apart = _correlation_interval(partial[i], errors[1, i], n - 1 - d)
        entries.append(Sensitivity(alone, apart, _share_interval(first[i], errors[2, i]), floor))
    return entries


def saltelli_indices(blocks: Floats) -> list[SobolIndices]:
    """Return the Sobol indices of each entry from the runs of Saltelli's design.

    Args:
        blocks: the metric f_A, f_B, f_AB1, ..., f_ABd (entries + 2 rows) (columns with a NaN are
            left out).

    Returns:
        One per entry, none for fewer than LEAST columns.
    """
    blocks = blocks[:, np.isfinite(blocks).all(axis=0)]
    if blocks.shape[1] < LEAST:
        return []
    first, total = estimate_sobol_indices(blocks)
    standard = jackknife_error(
        lambda columns: estimate_sobol_indices(blocks[:, columns]), blocks.shape[1]
    )
    errors = student_half_width(GROUPS - 1) * standard
    entries = []
    for i in range(len(first)):
        entries.append(
            SobolIndices(
                _share_interval(first[i], errors[0, i]), _share_interval(total[i], errors[1, i])
            )
        )
    return entries


def estimate_sobol_indices(blocks: Floats) -> Floats:
    """Return Sobol indices by Saltelli's estimator of 2010 (first) and Jansen's (total).

    Args:
        blocks: the metric f_A, f_B, f_AB1, ..., f_ABd (entries + 2 rows).

    Returns:
        [first, total] (2 x entries), or 0 if nothing varies.
    """
    blocks = blocks - blocks[:2].mean()
    f_A = blocks[0]
    f_B = blocks[1]
    f_AB = blocks[2:]
    variance = blocks[:2].var()
    first = (f_B * (f_AB - f_A)).mean(axis=1)
    total = ((f_A - f_AB) ** 2).mean(axis=1) / 2
    return np.stack([first, total]) / (variance or 1.0)


def rank_correlations(X: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Return Spearman's and the partial rank correlation of each entry with y, or 0 if nothing
    varies.

    The partial one correlates the residuals of both after regression on the ranks of the other
    entries.
    """
    from scipy.stats import rankdata

    ranks = rankdata(np.column_stack([X, y]), axis=0)
    ranks -= ranks.mean(axis=0)
    size = np.sqrt((ranks**2).sum(axis=0))
    size = np.where(size > 0, size, 1.0)
    R = ranks.T @ ranks / np.outer(size, size)  # of the ranks of X and, last, of y
    P = np.linalg.pinv(R, hermitian=True)  # the partial correlations, but for their scale
    scale = np.sqrt(np.diag(P)[:-1] * P[-1, -1])
    return R[:-1, -1], -P[:-1, -1] / np.where(scale > 0, scale, 1.0)


def first_order_indices(X: Floats, y: Floats) -> Floats:
    """Return the share of the variance of y that each entry explains, corrected for chance.

    An entry explains the variance that a straight line in each of its bins explains, 0 if the entry
    does not vary.
    """
    shares = np.zeros(X.shape[1])
    for i, x in enumerate(X.T):
        if np.ptp(x) > 0:
            order = np.argsort(x, kind="stable")
            shares[i] = _variance_share(x[order], y[order])
    return shares


def first_order_by_chance(y: Floats) -> float:
    """Return the first-order index that only a share 1 - LEVEL of uninfluential entries
    exceeds.

    It is found from permutations of y.
    """
    random = np.random.default_rng(0)
    x = np.arange(y.size, dtype=float)
    shares = [_variance_share(x, random.permutation(y)) for _ in range(PERMUTATIONS)]
    return float(np.quantile(shares, LEVEL))


def _variance_share(x: Floats, y: Floats) -> float:
    """Return 1 - (variance about a line in each bin) / (variance of y), both unbiased.

    x ascends, and its n^(2/5) bins hold equally many runs.
    """
    n = y.size
    count = int(np.ceil(n**0.4))
    starts = np.arange(count) * n // count
    sizes = np.diff(starts, append=n)
    dx = _subtract_bin_means(x, starts, sizes)
    dy = _subtract_bin_means(y, starts, sizes)
    xx = np.add.reduceat(dx * dx, starts)
    xy = np.add.reduceat(dx * dy, starts)
    sloped = xx > 0
    freedom = n - count - int(sloped.sum())
    within = float((dy * dy).sum() - (xy[sloped] ** 2 / xx[sloped]).sum()) / freedom
    total = float(y.var(ddof=1))
    return 1 - within / total if total > 0 else 0.0


def _subtract_bin_means(v: Floats, starts: Integers, sizes: Integers) -> Floats:
    """Return v minus its mean in each bin."""
    return v - np.repeat(np.add.reduceat(v, starts) / sizes, sizes)


def _correlation_interval(r: float, error: float, freedom: int) -> Correlation:
    """Return a correlation with its interval and the p value of Student's test.

    The interval is symmetric in arctanh r (Fisher), and so stays within -1 and 1. As d arctanh r /
    dr = 1 / (1 - r^2), its half width there is error / (1 - r^2).

    Args:
        r: the correlation.
        error: half width of its interval.
        freedom: degrees of freedom of the test statistic r sqrt(freedom / (1 - r^2)).
    """
    from scipy.special import stdtr

    r = float(np.clip(r, -1.0, 1.0))
    unexplained = 1 - r**2
    if unexplained < 1e-12:
        return Correlation(r, r, r, 0.0)
    low, high = np.tanh(np.arctanh(r) + np.array([-1, 1]) * error / unexplained)
    p = 2 * stdtr(freedom, -abs(r) * np.sqrt(freedom / unexplained))
    return Correlation(r, float(low), float(high), float(p))


def _share_interval(value: float, error: float) -> Interval:
    """Return a share with its interval, both clipped to 0 .. 1."""
    value, low, high = np.clip([value, value - error, value + error], 0.0, 1.0)
    return Interval(float(value), float(low), float(high))
