"""Tests of a fitted scenario against the logs: does anything in the readings contradict it?

Each reading has a normal score: its quantile in its predictive distribution, as a quantile of the
normal distribution. A silent reading has a random one within its piece. Scores of a true model are
independent and standard normal.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy import stats
from scipy.linalg import orth
from scipy.special import ndtr, ndtri

from undeadzone.util.arrays import Floats
from undeadzone_identify.fitting.likelihood import LEAST_AFTER
from undeadzone_identify.fitting.problem import SURE, FitProblem

LAGS: Final = (1, 2, 3, 5, 8, 13, 21, 34, 55, 89)  # samples over which scores are correlated
FLAGGED: Final = 0.02  # probability that a true model is flagged, all tests together
FARTHEST: Final = 1e-12  # chance beyond which a score is not followed
SEED: Final = 7  # of the scores of silent readings: a random sequence, or they are not white


def score_readings(problem: FitProblem, point: Floats) -> Floats:
    """Return the normal scores of all readings (N x p), NaN if one is missing."""
    _, prediction, log_std = (part[0] for part in problem.record_lanes(point[None]))
    std = np.exp(log_std)
    _, params = problem.to_lanes(point[None], (0.0, 0.0), 0)
    right, left, slope, before, after = (params[0, part] for part in problem.slots[1:6])
    y = problem.whole.y
    chance = ndtr((y - prediction) / std)
    if problem.kind != "plain":
        noise = np.maximum(after, LEAST_AFTER * before + 1e-12)
        slack = SURE * noise * (problem.kind == "deadzone")
        edges = -left * slope - slack, right * slope + slack
        low, high = (ndtr((edge - prediction) / std) for edge in edges)
        random = low + (high - low) * np.random.default_rng(SEED).random(y.shape)
        chance = np.where(problem.whole.side == 0, random, chance)
    scores = ndtri(np.clip(chance, FARTHEST, 1 - FARTHEST))
    return np.where(np.isfinite(y), scores, np.nan)


def check_scores(u: Floats, z: Floats, scores: Floats) -> dict[str, float]:
    """Return the probability of each test under a true model, by name.

    The tests: size of the scores, their mean, whether they are white, and whether their mean
    depends on input or output (shape).

    Args:
        u: inputs (N x m).
        z: predictions of the readings (N x p).
        scores: normal scores of the readings (N x p), NaN if one is missing.
    """
    v = np.nan_to_num(scores)
    seen = np.isfinite(scores)
    count = seen.sum()
    square = np.sum(v**2)
    off = seen * (v - v.sum(axis=0) / seen.sum(axis=0))
    sums = np.array(
        [
            (off[lag:] * off[:-lag]).sum(axis=0) / np.sqrt(len(v) - lag)
            for lag in LAGS
            if lag < len(v)
        ]
    )
    both = np.hstack([u, z])
    columns = np.hstack([both, both**2, np.abs(both)])
    columns -= columns.mean(axis=0)
    q = orth(columns / (columns.std(axis=0) + 1e-300))  # |z| may be z or -z
    return {
        "size": float(2 * min(stats.chi2.cdf(square, count), stats.chi2.sf(square, count))),
        "mean": float(2 * stats.norm.sf(abs(v.sum()) / np.sqrt(count))),
        "white": float(stats.chi2.sf(np.sum(sums**2), sums.size)),
        "shape": float(stats.chi2.sf(np.sum((q.T @ off) ** 2), q.shape[1] * off.shape[1])),
    }
