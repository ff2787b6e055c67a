"""Which varied entry a metric depends on: rank correlations and Sobol indices of given runs, and those of Saltelli's design.

X (runs x entries) and y (runs) are finite numbers. After Plischke, Borgonovo and Smith 2013 and Saltelli et al. 2010.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.statistics.intervals import GROUPS, LEVEL, Interval, jackknife, student
from undeadzone.support.arrays import Floats

LEAST: Final = 2 * GROUPS  # runs, below which nothing is said
PERMUTATIONS: Final = 200


class Correlation(NamedTuple):
    """A rank correlation, its interval, and the probability of one as large if there were none."""

    value: float
    low: float
    high: float
    p: float


class Given(NamedTuple):
    """What the runs as they are tell of one entry; floor: what the first-order index reaches by chance once in twenty."""

    spearman: Correlation
    partial: Correlation
    first: Interval
    floor: float


class Indices(NamedTuple):
    """Sobol indices of one entry from Saltelli's design: alone, and with everything that it interacts with."""

    first: Interval
    total: Interval


def given(X: Floats, y: Floats) -> list[Given]:
    """Spearman's and the partial rank correlation and the first-order Sobol index of each entry; none for fewer than LEAST runs, or if all are alike."""
    n, d = X.shape
    if n < max(LEAST, d + 4) or np.ptp(y) == 0:
        return []

    def estimate(rows: Floats) -> Floats:
        return np.stack([*rank_correlations(X[rows], y[rows]), first_order(X[rows], y[rows])])

    (spearman, partial, first), errors = (
        estimate(np.full(n, True)),
        student(GROUPS - 1) * jackknife(estimate, n),
    )
    floor = chance(y)
    return [
        Given(
            _correlation(spearman[i], errors[0, i], n - 2),
            _correlation(partial[i], errors[1, i], n - 1 - d),
            _share(first[i], errors[2, i]),
            floor,
        )
        for i in range(d)
    ]


def saltelli(blocks: Floats) -> list[Indices]:
    """First and total order of each entry from the runs f_A, f_B, f_AB1, ..., f_ABd (entries + 2 rows); columns with a NaN are left out."""
    blocks = blocks[:, np.isfinite(blocks).all(axis=0)]
    if blocks.shape[1] < LEAST:
        return []
    found = indices(blocks)
    errors = student(GROUPS - 1) * jackknife(lambda kept: indices(blocks[:, kept]), blocks.shape[1])
    return [
        Indices(*map(_share, index, error)) for index, error in zip(found.T, errors.T, strict=True)
    ]


def indices(blocks: Floats) -> Floats:
    """[first, total] (2 x entries) of the rows f_A, f_B, f_AB1, ...: Saltelli's 2010 and Jansen's estimators, 0 where nothing varies."""
    f_A, f_B, *_ = blocks = blocks - blocks[:2].mean()
    f_AB, variance = blocks[2:], blocks[:2].var()
    return np.stack([(f_B * (f_AB - f_A)).mean(axis=1), ((f_A - f_AB) ** 2).mean(axis=1) / 2]) / (
        variance or 1.0
    )


def rank_correlations(X: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Spearman's correlation of each entry with y, and that of what the ranks of the other entries leave of both; 0 where nothing varies."""
    ranks = np.column_stack([mean_ranks(column) for column in (*X.T, y)])
    ranks -= ranks.mean(axis=0)
    size = np.sqrt((ranks**2).sum(axis=0))
    R = ranks.T @ ranks / np.outer(*2 * [np.where(size > 0, size, 1.0)])
    P = np.linalg.pinv(R, hermitian=True)
    scale = np.sqrt(np.diag(P)[:-1] * P[-1, -1])
    return R[:-1, -1], -P[:-1, -1] / np.where(scale > 0, scale, 1.0)


def mean_ranks(x: Floats) -> Floats:
    """From 1 for the least; numbers that are alike share the mean of their ranks."""
    _, place, count = np.unique(x, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[place]


def first_order(X: Floats, y: Floats) -> Floats:
    """The share of the variance of y that a straight line in each bin of x explains, without what it would explain by chance."""

    def of(x: Floats) -> float:
        order = np.argsort(x, kind="stable")
        return _explained(x[order], y[order])

    return np.array([of(x) if np.ptp(x) > 0 else 0.0 for x in X.T])


def chance(y: Floats) -> float:
    """The first-order index that an entry without influence exceeds with probability 1 - LEVEL, from permutations of y."""
    random, x = np.random.default_rng(0), np.arange(y.size, dtype=float)
    return float(
        np.quantile([_explained(x, random.permutation(y)) for _ in range(PERMUTATIONS)], LEVEL)
    )


def _explained(x: Floats, y: Floats) -> float:
    """1 - (variance about the lines) / (variance of y), both unbiased; x ascends, its n^(2/5) bins hold equally many runs."""
    n, count = y.size, int(np.ceil(y.size**0.4))
    starts = np.arange(count) * n // count
    sizes = np.diff(starts, append=n)
    dx, dy = (v - np.repeat(np.add.reduceat(v, starts) / sizes, sizes) for v in (x, y))
    xx, xy = np.add.reduceat(dx * dx, starts), np.add.reduceat(dx * dy, starts)
    sloped = xx > 0
    within = float((dy * dy).sum() - (xy[sloped] ** 2 / xx[sloped]).sum()) / (
        n - count - int(sloped.sum())
    )
    total = float(y.var(ddof=1))
    return 1 - within / total if total > 0 else 0.0


def _correlation(r: float, error: float, freedom: int) -> Correlation:
    """The interval is one of arctanh r; p is of Student's test."""
    from scipy.special import stdtr

    r = float(np.clip(r, -1.0, 1.0))
    room = 1 - r**2
    if room < 1e-12:
        return Correlation(r, r, r, 0.0)
    low, high = np.tanh(np.arctanh(r) + np.array([-1, 1]) * error / room)
    return Correlation(
        r, float(low), float(high), float(2 * stdtr(freedom, -abs(r) * np.sqrt(freedom / room)))
    )


def _share(value: float, error: float) -> Interval:
    """Within 0 and 1, where the true one lies."""
    return Interval(*(float(x) for x in np.clip([value, value - error, value + error], 0.0, 1.0)))
