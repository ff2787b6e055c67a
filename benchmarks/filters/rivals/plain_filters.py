"""Filters of [s; d_r; d_l] in plain NumPy: a Kalman prediction, corrected by each reading."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import norm

from benchmarks.filters.exact_posterior import EVERY
from benchmarks.filters.problems.exact_problems import RANGE, Problem
from benchmarks.filters.rivals.filterpy_filters import unscented
from undeadzone.numerics.deadzone_update import SILENT, DeadzoneMemory, deadzone_update
from undeadzone.util.arrays import Floats

SHARE = 0.16  # of a quarter period, for which an edge is not updated again: a 25th of a period

Correct = Callable[[Floats, Floats, float], tuple[Floats, Floats]]
"""(mean, covariance, reading) -> mean and covariance."""


class Track(NamedTuple):
    """Means and standard deviations of z, d_r, d_l at each snapshot (snapshots x 3)."""

    mean: Floats
    std: Floats


class Rows(NamedTuple):
    """Rows that read z, d_r, d_l from the mean."""

    z: Floats
    right: Floats
    left: Floats


def rows(posed: Problem) -> Rows:
    """The rows of a problem."""
    eye = np.eye(posed.order + 3)
    return Rows(eye[0], eye[-2], eye[-1])


def tracked(posed: Problem, correct: Correct) -> Track:
    """What a Kalman filter with this correction makes of a problem."""
    m, P, F, G, Q = _linear(posed)
    h = np.stack(rows(posed))
    means, stds = [], []
    for i, (y, u) in enumerate(zip(posed.y, posed.u, strict=True)):
        m, P = correct(m, P, float(y))
        if i % EVERY == EVERY - 1:
            means.append(h @ m)
            stds.append(np.sqrt(np.maximum(np.diag(h @ P @ h.T), 0.0)))
        m, P = F @ m + G * u, F @ P @ F.T + Q
    return Track(np.stack(means), np.stack(stds))


def _linear(posed: Problem) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Mean and covariance of [s; d_r; d_l] at first, F, G and Q of its motion."""
    n = posed.order + 1
    F, Q, P = np.eye(n + 2), np.zeros((n + 2, n + 2)), np.eye(n + 2) * np.ptp(RANGE) ** 2 / 12
    F[:n, :n], Q[:n, :n], P[:n, :n] = posed.F, posed.Q, posed.P
    mean = np.append(np.zeros(n), np.full(2, np.mean(RANGE)))
    return mean, P, F, np.append(posed.G, np.zeros(2)), Q


def hearing(posed: Problem) -> Correct:
    """`uz.deadzone_update`, in the way of docs/deadzone_update.md."""
    C, right, left = rows(posed)
    memory = DeadzoneMemory()
    rest = max(1, round(SHARE * np.pi / 2 / posed.frequency / 0.01))

    def correct(m: Floats, P: Floats, y: float) -> tuple[Floats, Floats]:
        nonlocal memory
        behind = 0.0 if posed.ahead else posed.noise
        before = posed.noise if posed.ahead else 0.0
        updated = deadzone_update(
            m,
            P,
            C,
            y,
            right=right,
            left=left,
            noise=behind,
            noise_before=before,
            memory=memory,
            rest=rest,
        )
        memory = updated.memory
        return updated.mean, updated.cov

    return correct


def matching(posed: Problem) -> Correct:
    """Moment matching at every sample: a silent one is cut at both edges, one after the other."""
    C, right, left = rows(posed)
    R = posed.noise**2
    gate = 0.0 if posed.ahead else SILENT * posed.noise

    def correct(m: Floats, P: Floats, y: float) -> tuple[Floats, Floats]:
        if abs(y) > gate:
            h = C - right if y > 0 else C + left
            return corrected(m, P, h, h @ P @ h + R, y - h @ m)
        for h in (C - right, -C - left):
            S = h @ P @ h + R
            alpha = (gate - h @ m) / np.sqrt(S)
            ratio = np.exp(norm.logpdf(alpha) - norm.logcdf(alpha))
            K = P @ h / S
            m = m - K * np.sqrt(S) * ratio
            P = P - ratio * (ratio + alpha) * S * np.outer(K, K)
        return m, (P + P.T) / 2

    return correct


def tobit(posed: Problem) -> Correct:
    """The Tobit Kalman filter of Allik et al. (2016) for the two edges of a dead zone.

    A reading is linear on each branch, and branches count by their chance, here with the spread of
    the prediction in it: without that it diverges.
    """
    C, right, left = rows(posed)
    R = posed.noise**2

    def correct(m: Floats, P: Floats, y: float) -> tuple[Floats, Floats]:
        expected, square, slope = 0.0, 0.0, np.zeros(len(m))
        for sign, h in ((1.0, C - right), (-1.0, -C - left)):
            std = np.sqrt(h @ P @ h + R)
            beyond = h @ m / std
            chance, density = norm.cdf(beyond), norm.pdf(beyond)
            expected += sign * std * (chance * beyond + density)
            square += std**2 * (chance * (1 + beyond**2) + beyond * density)
            slope = slope + sign * chance * h
        S = max(square - expected**2, slope @ P @ slope + 1e-3 * R)
        return corrected(m, P, slope, S, y - expected)

    return correct


def corrected(m: Floats, P: Floats, h: Floats, S: float, e: float) -> tuple[Floats, Floats]:
    """Mean and covariance after a reading of h x of variance S, off by e."""
    K = P @ h / S
    P = P - S * np.outer(K, K)
    return m + K * e, (P + P.T) / 2


def filterpy_unscented(posed: Problem) -> Track:
    """FilterPy's UKF."""
    rival: Any
    rival, correct = unscented(posed.order + 1)
    rival.x, rival.P, F, G, Q = _linear(posed)
    rival.Q, rival.R = Q + 1e-10 * np.eye(len(Q)), np.full((1, 1), posed.noise**2)
    h = np.stack(rows(posed))
    means, stds = [], []
    for i, (y, u) in enumerate(zip(posed.y, posed.u, strict=True)):
        correct(y)
        if i % EVERY == EVERY - 1:
            means.append(h @ rival.x)
            stds.append(np.sqrt(np.maximum(np.diag(h @ rival.P @ h.T), 0.0)))
        rival.predict(F=F, G=G * u)
    return Track(np.stack(means), np.stack(stds))
