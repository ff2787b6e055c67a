"""States along a record with their deviations: the filter of (L3) run forth and back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.kalman_likelihood import KalmanFit
from undeadzone.identification.kalman_step import matrices
from undeadzone.identification.likelihood import hazards, log_difference
from undeadzone.identification.log import Flags
from undeadzone.support.arrays import Floats, Integers


class Smoothed(NamedTuple):
    """The state of plant and disturbance, in observer form, scaled.

    Attributes:
        x: means (N x size).
        P: covariances (N x size x size).
        H: the row that makes z of x (size).
    """

    x: Floats
    P: Floats
    H: Floats

    @property
    def z(self) -> Floats:
        """z, with the disturbance (N)."""
        return self.x @ self.H

    @property
    def z_std(self) -> Floats:
        """Standard deviations of z, the numbers of the model taken as known (N)."""
        variance = np.einsum("i,tij,j->t", self.H, self.P, self.H)
        return np.sqrt(np.maximum(variance, 0.0))


class _Pass(NamedTuple):
    """Predicted and corrected moments along a record, and g of each correction."""

    x_ahead: Floats
    P_ahead: Floats
    x: Floats
    P: Floats
    g: Floats


def smooth(fit: KalmanFit, p: Floats | None = None) -> Smoothed:
    """Fixed-interval smoothing (Rauch, Tung and Striebel 1965) on the filter's moments.

    Args:
        fit: of (L3).
        p: other numbers than the fitted ones; default these.

    Returns:
        Means and covariances along the record.
    """
    model = _Model(fit, fit.p if p is None else p)
    data = fit.objective.data
    count = model.F.shape[0]
    x_out, P_out = np.empty((data.y.size, count)), np.empty((data.y.size, count, count))
    for part in data.records():
        x_out[part], P_out[part] = _back(model.F, model.forth(part))
    return Smoothed(x_out, P_out, model.H)


def innovations(fit: KalmanFit) -> Floats:
    """One-step prediction errors over their standard deviations (N); 0 where missing."""
    model = _Model(fit, fit.p)
    return np.concatenate([model.forth(part).g for part in fit.objective.data.records()])


class _Model:
    """Matrices of plant and disturbance for some numbers p of (L3)."""

    def __init__(self, fit: KalmanFit, p: Floats) -> None:
        numbers = fit.objective.numbers
        self.data = fit.objective.data
        lane = fit.objective.lane(p)
        self.F, B, G, H = matrices(numbers.n, numbers.m, numbers.model, lane)
        self.H = H[0]
        self.Q = lane[numbers.lane_q] * G
        self.sensor = lane[numbers.lane_q + 1 : numbers.lane_q + 4]
        self.first = np.full(self.F.shape[0], lane[numbers.lane_q + 5])
        if numbers.model:
            self.first[-1] = lane[numbers.lane_q + 6]
        self.drive = self.data.u @ B.T

    def forth(self, part: slice) -> _Pass:
        """The filter along one record."""
        data = self.data
        corrections = _Corrections(data.y[part], data.side[part], data.ok[part], *self.sensor)
        P = np.diag(self.first)
        return _forth(self.F, self.Q, self.H, self.drive[part], corrections, P)


class _Corrections(NamedTuple):
    """Readings of a record and the sensor's numbers."""

    y: Floats
    side: Integers
    ok: Flags
    r2: float
    right: float
    left: float

    def at(self, t: int, mean: float, S: float) -> tuple[float, float]:
        """g and k of one reading: x += P H' g / s, P -= P H' H P k / S."""
        s = math.sqrt(S)
        if self.side[t] > 0:
            return (self.y[t] + self.right - mean) / s, 1.0
        if self.side[t] < 0:
            return (self.y[t] - self.left - mean) / s, 1.0
        a, b = (self.right - mean) / s, (-self.left - mean) / s
        upper, lower = np.array([a]), np.array([b])
        mass = log_difference(upper, lower)
        if mass[0] < -700 or a - b < 1e-6:
            return min(max(0.0, b), a), 1 - min(1.0, (a - b) ** 2 / 12)
        at_a, at_b = (float(one[0]) for one in hazards(upper, lower, mass))
        g = min(max(at_b - at_a, b), a)
        k = (at_b - at_a) ** 2 + a * at_a - b * at_b
        return g, min(max(k, 0.0), 1.0)


def _forth(
    F: Floats, Q: Floats, H: Floats, drive: Floats, readings: _Corrections, P: Floats
) -> _Pass:
    """The filter along a record."""
    size, n = drive.shape[0], F.shape[0]
    run = _Pass(
        np.empty((size, n)),
        np.empty((size, n, n)),
        np.empty((size, n)),
        np.empty((size, n, n)),
        np.zeros(size),
    )
    x = np.zeros(n)
    pad = np.zeros(n - drive.shape[1])
    for t in range(size):
        run.x_ahead[t], run.P_ahead[t] = x, P
        if readings.ok[t]:
            PH = P @ H
            S = float(H @ PH) + readings.r2
            g, k = readings.at(t, float(H @ x), S)
            run.g[t] = g
            x = x + PH * (g / math.sqrt(S))
            P = P - np.outer(PH, PH) * (k / S)
        run.x[t], run.P[t] = x, P
        x = F @ x + np.concatenate([drive[t], pad])
        P = F @ P @ F.T + Q
    return run


def _back(F: Floats, run: _Pass) -> tuple[Floats, Floats]:
    """The smoother back along a record."""
    x, P = run.x.copy(), run.P.copy()
    ridge = 1e-12 * np.eye(F.shape[0])
    for t in range(x.shape[0] - 2, -1, -1):
        gain = np.linalg.solve(run.P_ahead[t + 1] + ridge, F @ run.P[t]).T
        x[t] = run.x[t] + gain @ (x[t + 1] - run.x_ahead[t + 1])
        P[t] = run.P[t] + gain @ (P[t + 1] - run.P_ahead[t + 1]) @ gain.T
    return x, P


def smoothed_with_spread(fit: KalmanFit) -> tuple[Smoothed, Floats]:
    """The smoothed states and the standard deviation of z, the spread of the numbers included.

    Args:
        fit: of (L3).

    Returns:
        States, and deviations of z (N), by the delta method from the covariance of (I1).
    """
    middle = smooth(fit)
    V = fit.objective.spread(fit.p).V
    values, vectors = np.linalg.eigh(V)
    variance = middle.z_std**2
    for value, vector in zip(values, vectors.T, strict=True):
        if value <= 1e-14:
            continue
        scale = 0.1 * math.sqrt(value)
        moved = fit.p.copy()
        moved[fit.objective.free] += scale * vector
        if fit.objective.admissible(moved):
            variance = variance + ((smooth(fit, moved).z - middle.z) / 0.1) ** 2
    return middle, np.sqrt(variance)
