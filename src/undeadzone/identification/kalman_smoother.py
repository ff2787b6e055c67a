"""States along a record with their deviations: the filter of (L3) run forth and back."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.identification.kalman_fit import KalmanFit
from undeadzone.identification.kalman_step import matrices
from undeadzone.support.arrays import Floats


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
    """Predicted and corrected moments along the records (N x ...), and g of each correction."""

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
    p = fit.p if p is None else p
    F, H = _motion(fit, p)
    forth = _forth(fit, p)
    gains = _gains(F, forth)
    x, P = forth.x.copy(), forth.P.copy()
    for part in fit.objective.data.records():
        for t in range(part.stop - 2, part.start - 1, -1):
            gain = gains[t]
            x[t] += gain @ (x[t + 1] - forth.x_ahead[t + 1])
            P[t] += gain @ (P[t + 1] - forth.P_ahead[t + 1]) @ gain.T
    return Smoothed(x, P, H)


def _smoothed_z(fit: KalmanFit, p: Floats) -> Floats:
    """The mean of `smooth` alone, as z (N)."""
    F, H = _motion(fit, p)
    forth = _forth(fit, p)
    gains = _gains(F, forth)
    x = forth.x
    for part in fit.objective.data.records():
        for t in range(part.stop - 2, part.start - 1, -1):
            x[t] += gains[t] @ (x[t + 1] - forth.x_ahead[t + 1])
    return x @ H


def innovations(fit: KalmanFit) -> Floats:
    """One-step prediction errors over their standard deviations (N); 0 where missing."""
    return _forth(fit, fit.p).g


def _motion(fit: KalmanFit, p: Floats) -> tuple[Floats, Floats]:
    """F, and the row H that makes z of x."""
    numbers = fit.objective.numbers
    F, _, _, H = matrices(numbers.n, numbers.m, numbers.model, fit.objective.lane(p))
    return F, H[0]


def _forth(fit: KalmanFit, p: Floats) -> _Pass:
    """The filter along the records."""
    rows = fit.objective.outputs(p[None, :], moments=True)[0]
    size = fit.objective.numbers.n + (fit.objective.numbers.model > 0)
    entries = size * (size + 1) // 2
    ends = np.cumsum([size, entries, size, entries])
    x_ahead, ahead, x, after, g = np.split(rows, ends, axis=1)
    return _Pass(x_ahead, _square(ahead, size), x.copy(), _square(after, size), g[:, 0])


def _square(triangles: Floats, size: int) -> Floats:
    """Symmetric matrices (N x size x size) of their upper parts, column by column."""
    out = np.empty((len(triangles), size, size))
    columns, rows = np.tril_indices(size)
    out[:, rows, columns] = triangles
    out[:, columns, rows] = triangles
    return out


def _gains(F: Floats, forth: _Pass) -> Floats:
    """The smoother's gain from each sample to the one before (N - 1 x size x size)."""
    ridge = 1e-12 * np.eye(F.shape[0])
    return np.linalg.solve(forth.P_ahead[1:] + ridge, F @ forth.P[:-1]).transpose(0, 2, 1)


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
            variance = variance + ((_smoothed_z(fit, moved) - middle.z) / 0.1) ** 2
    return middle, np.sqrt(variance)
