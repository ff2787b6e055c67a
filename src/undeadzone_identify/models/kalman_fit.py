"""Fit of (L2) for three disturbance models, and the smoothed states along the records."""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import (
    best_maximum,
    maximise_likelihood,
    propagate_covariance,
)
from undeadzone_identify.models.kalman import (
    AT_INPUT,
    AT_OUTPUT,
    QUIETEST,
    WHITE,
    KalmanObjective,
    observer_form_matrices,
)
from undeadzone_identify.models.plant import busiest_stretches
from undeadzone_identify.models.zone_fit import ZoneFit

MODELS = (WHITE, AT_INPUT, AT_OUTPUT)
SHARES = (0.2, 0.8)  # start values of the disturbance model's share of the noise in (L1)


class KalmanFit(NamedTuple):
    """Fit of (L2).

    Attributes:
        objective: the likelihood that was maximised.
        theta: parameters of its maximum (P).
        value: the log likelihood there.
    """

    objective: KalmanObjective
    theta: Floats
    value: float

    @property
    def bic(self) -> float:
        """Return the BIC, -2 L + P ln N."""
        count = self.objective.data.ok.sum()
        return -2 * self.value + self.objective.free.size * math.log(count)

    @property
    def model(self) -> int:
        """Return the disturbance model: WHITE, AT_INPUT or AT_OUTPUT."""
        return self.objective.model

    @property
    def right(self) -> float:
        """Return d_r, scaled."""
        return float(self.theta[self.objective.log_q + 2])

    @property
    def left(self) -> float:
        """Return d_l, scaled."""
        place = self.objective.log_q + 3 - self.objective.limits.tied  # d_r, if they are equal
        return float(self.theta[place])

    @property
    def white_rms(self) -> float:
        """Return the rms of white noise ahead of the zone, scaled."""
        return max(math.exp(self.theta[self.objective.log_q + 1]), QUIETEST)

    @property
    def driving_rms(self) -> float:
        """Return the rms of the noise that drives the disturbance, scaled."""
        return math.exp(self.theta[self.objective.log_q])

    @property
    def disturbance_memory(self) -> float:
        """Return the correlation of the disturbance over a sample [1]."""
        return math.tanh(self.theta[-1]) if self.model else 0.0


def fit_kalman(fit: ZoneFit) -> list[KalmanFit]:
    """Fit (L2) for the three disturbance models; return the fits, the least BIC first.

    A long log is fitted in its busiest part first.

    Args:
        fit: fit of single samples, which gives the start points.

    Returns:
        A fit per model; empty if no filter could be run.
    """
    data = fit.objective.data
    layout = fit.objective.layout
    part = busiest_stretches(data)
    fits = []
    for model in MODELS:
        objective = KalmanObjective(part, layout, model, fit.objective.limits)
        starts = [objective.start_from_samples(fit, share) for share in SHARES]
        maximum = best_maximum(objective, starts, 12, 50, -math.inf)
        if maximum is None:
            continue
        if part is not data:
            objective = KalmanObjective(data, layout, model, fit.objective.limits)
            maximum = maximise_likelihood(objective, maximum.theta, 50)
        fits.append(KalmanFit(objective, *maximum))
    return sorted(fits, key=lambda kalman: kalman.bic)


# --- Smoothed states


class SmoothedStates(NamedTuple):
    """State of plant and disturbance in observer form, scaled.

    Attributes:
        x: means (N x size).
        P: covariances (N x size x size).
        H: output row, z = H x (size).
    """

    x: Floats
    P: Floats
    H: Floats

    @property
    def z(self) -> Floats:
        """Return z with the disturbance (N), scaled."""
        return self.x @ self.H

    @property
    def z_std(self) -> Floats:
        """Return standard deviations of z for known parameters (N), scaled."""
        variance = np.einsum("i,tij,j->t", self.H, self.P, self.H)
        return np.sqrt(np.maximum(variance, 0.0))


class _FilterPass(NamedTuple):
    """Predicted and corrected moments along the records (N x ...), and g of each correction."""

    x_ahead: Floats
    P_ahead: Floats
    x: Floats
    P: Floats
    g: Floats


def smooth_states(fit: KalmanFit) -> SmoothedStates:
    """Smooth the filter's moments over a fixed interval (Rauch, Tung and Striebel 1965).

    References:
        H. E. Rauch, F. Tung, C. T. Striebel (1965), doi:10.2514/3.3166

    Args:
        fit: of (L2).

    Returns:
        Means and covariances along the record.
    """
    return _run_backward(fit, fit.theta)


def filter_innovations(fit: KalmanFit) -> Floats:
    """Return the innovations divided by their standard deviations (N) [1]; 0 if missing."""
    return _run_filter(fit, fit.theta).g


def _run_filter(fit: KalmanFit, p: Floats) -> _FilterPass:
    """Run the filter along the records with parameters p (P)."""
    rows = fit.objective.kernel_outputs(p[None, :], moments=True)[0]
    size = fit.objective.layout.n + (fit.model > 0)
    entries = size * (size + 1) // 2
    ends = np.cumsum([size, entries, size, entries])
    x_ahead, ahead, x, after, g = np.split(rows, ends, axis=1)
    return _FilterPass(x_ahead, _to_square(ahead, size), x, _to_square(after, size), g[:, 0])


def _to_square(triangles: Floats, size: int) -> Floats:
    """Convert upper parts, column by column, to symmetric matrices (N x size x size)."""
    out = np.empty((len(triangles), size, size))
    columns, rows = np.tril_indices(size)
    out[:, rows, columns] = triangles
    out[:, columns, rows] = triangles
    return out


def _run_backward(fit: KalmanFit, p: Floats) -> SmoothedStates:
    """Return the backward pass of the smoother, for each record from its end.

    Args:
        fit: fit of (L2).
        p: parameters, perhaps others than those of the fit (P).
    """
    forth = _run_filter(fit, p)
    layout = fit.objective.layout
    numbers = ca.DM(fit.objective.lane_numbers(p))
    F, _, _, H = (
        part.full() for part in observer_form_matrices(layout.n, layout.m, fit.model, numbers)
    )
    ridge = 1e-12 * np.eye(F.shape[0])
    gains = np.linalg.solve(forth.P_ahead[1:] + ridge, F @ forth.P[:-1]).transpose(0, 2, 1)
    x, P = forth.x.copy(), forth.P.copy()
    for part in fit.objective.data.record_slices():
        for t in range(part.stop - 2, part.start - 1, -1):
            x[t] += gains[t] @ (x[t + 1] - forth.x_ahead[t + 1])
            P[t] += gains[t] @ (P[t + 1] - forth.P_ahead[t + 1]) @ gains[t].T
    return SmoothedStates(x, P, H[0])


def smooth_with_deviation(fit: KalmanFit) -> tuple[SmoothedStates, Floats]:
    """Return the smoothed states, and standard deviations of z with uncertain parameters (N).

    The variance by the parameters follows from the robust covariance by the delta method: z is
    smoothed again with the parameters shifted along each eigenvector.

    Args:
        fit: fit of (L2).
    """
    middle = smooth_states(fit)

    def move_z(move: Floats) -> Floats:
        """Return the change of z with that of the free parameters."""
        shifted = fit.theta.copy()
        shifted[fit.objective.free] += move
        if not fit.objective.can_run_filter(shifted):
            return np.zeros_like(middle.z)
        return _run_backward(fit, shifted).z - middle.z

    V = fit.objective.robust_covariance(fit.theta).V
    return middle, np.sqrt(middle.z_std**2 + propagate_covariance(V, move_z))
