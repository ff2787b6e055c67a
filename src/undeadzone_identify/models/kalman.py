"""Likelihood (L2) of a record by the measured-side Kalman filter.

A step of the filter is a compiled graph that runs for many parameter sets at once.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.compile import lanes
from undeadzone.numerics.gaussian import normal_cdf, to_upper_entries
from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.models import estimates
from undeadzone_identify.models.likelihood import log_unit_density
from undeadzone_identify.models.plant import Layout, RecordData, input_noise_gain, polynomial_roots
from undeadzone_identify.models.zone import WidthLimits
from undeadzone_identify.models.zone_fit import ZoneFit

# models of the disturbance
WHITE = 0
AT_INPUT = 1
AT_OUTPUT = 2
NAMES = ("white at the input", "first order at the input", "first order at the output")
QUIETEST = 1e-3  # least rms of white noise ahead of the zone [rms of y]
STEP = 1e-4  # relative step of a parameter, for differences
TAIL = -4.0  # argument below which Phi is computed by its continued fraction
DEPTH = 12  # terms of the fraction: exact to rounding below TAIL
WIDTH = 32  # lanes of a kernel: central differences by the parameters of a plant of order 6
WORST = -1e3  # log density of a sample if the filter has diverged
FLOOR = -1e4  # least log density of a sample
NARROW = 1e-6  # width below which a zone counts as a point [standard deviations]


# --- A sample


def log_normal_cdf(x: Any) -> Any:
    """Return ln Phi(x) on CasADi expressions."""
    near = ca.fmax(x, TAIL)
    far = ca.fmax(-x, -TAIL)
    fraction = far
    for k in range(DEPTH, 0, -1):
        fraction = far + k / fraction
    tail = log_unit_density(far) - ca.log(fraction)
    return ca.if_else(x > TAIL, ca.log(normal_cdf(near)), tail)


def log_interval_mass(a: Any, b: Any) -> Any:
    """Return ln(Phi(a) - Phi(b)) on CasADi expressions, a > b."""
    flip = b > 0
    upper = ca.if_else(flip, -b, a)
    lower = ca.if_else(flip, -a, b)
    top = log_normal_cdf(upper)
    gap = ca.fmin(log_normal_cdf(lower) - top, -1e-12)
    width = ca.fmax(upper - lower, 1e-12)
    point = ca.log(width) + log_unit_density(0.5 * (upper + lower))
    return ca.if_else(upper - lower < 1e-5, point, top + ca.log(1 - ca.exp(gap)))


def measurement_terms(
    y: Any, side: Any, mean: Any, s: Any, right: Any, left: Any
) -> tuple[Any, Any, Any]:
    """Return a reading's log density, and g and k of its measurement update.

    The update is x += P H' g / s, P -= P H' H P k / s^2. Outside the zone it is that of a Kalman
    filter: g is the normalised innovation and k = 1. Inside, z is a truncated Gaussian: g is the
    shift of its mean, and 1 - k its variance, in standard deviations.

    Args:
        y: reading.
        side: +1, -1 beyond the right or left edge, 0 inside the zone.
        mean, s: mean and standard deviation of the predicted z.
        right, left: d_r and d_l.
    """
    outside = side != 0
    v = (y + right * (side > 0) - left * (side < 0) - mean) / s
    a = (y + right - mean) / s
    b = (y - left - mean) / s
    mass = log_interval_mass(a, b)
    at_a = ca.exp(ca.fmin(log_unit_density(a) - mass, 700.0))
    at_b = ca.exp(ca.fmin(log_unit_density(b) - mass, 700.0))
    # Far in a tail, or for a narrow zone, the moments cancel: use those of a uniform density.
    cancels = ca.logic_or(mass < -700.0, a - b < NARROW)
    shift = ca.if_else(cancels, 0.0, at_b - at_a)
    shift = ca.fmin(ca.fmax(shift, b), a)
    reduction = (at_b - at_a) ** 2 + a * at_a - b * at_b
    uniform = 1 - ca.fmin(1.0, (a - b) ** 2 / 12)
    reduction = ca.fmin(ca.fmax(ca.if_else(cancels, uniform, reduction), 0.0), 1.0)
    log_normal = log_unit_density(v) - ca.log(s)
    log = ca.fmax(ca.if_else(outside, log_normal, mass), FLOOR)
    return log, ca.if_else(outside, v, shift), ca.if_else(outside, 1.0, reduction)


@cache
def build_kalman_kernel(n: int, m: int, model: int, moments: bool) -> lanes.Kernel:
    """Build the compiled step of the filter.

    Args:
        n: order of the plant.
        m: number of inputs.
        model: WHITE at the inputs, first order AT_INPUT, or first order AT_OUTPUT.
        moments: whether the outputs are x and P before the reading, x and P after it, and g.

    Returns:
        A kernel with

        - state: x, then the upper triangle of P, column by column,
        - inputs: u, y, side, ok, and whether a record starts,
        - parameters of a lane: a, b input by input, q^2, r^2, d_r, d_l, phi, and the variances of x
          and of the disturbance at the start,
        - output: the log density of the reading, or the moments.
    """
    size = n + (model > 0)
    upper = ca.Sparsity.upper(size)
    state = ca.SX.sym("s", size + upper.nnz())
    exogenous = ca.SX.sym("w", m + 4)
    numbers = ca.SX.sym("p", n + m * n + 7)
    F, B, G, H = observer_form_matrices(n, m, model, numbers)
    q2, r2, right, left, _, first, first_w = ca.vertsplit(numbers[-7:])
    u = exogenous[:m]
    y, side, ok, start = ca.vertsplit(exogenous[m:])
    at_start = ca.diag(ca.vertcat(first * ca.SX.ones(n), *([first_w] * (model > 0))))
    previous = ca.SX(upper, state[size:])
    P = ca.triu2symm(ca.if_else(start, ca.project(at_start, upper), previous))
    x = ca.if_else(start, 0.0, state[:size])
    mean = H @ x
    PH = P @ H.T
    S = H @ PH + r2
    diverged = ca.logic_not(ca.logic_and(S < 1e12, ca.fabs(mean) < 1e9))
    s = ca.sqrt(ca.fmax(ca.if_else(diverged, 1.0, S), 1e-12))
    density, g, k = measurement_terms(y, side, ca.if_else(diverged, 0.0, mean), s, right, left)
    g = ok * g
    k = ok * k
    before = ca.vertcat(x, to_upper_entries(P, upper))
    x = x + PH * g / s
    P = P - PH @ PH.T * k / s**2
    all_moments = ca.vertcat(before, x, to_upper_entries(P, upper), g)
    x = F @ x + B @ u
    P = F @ P @ F.T + q2 * G
    following = ca.vertcat(x, to_upper_entries(P, upper))
    log = ok * ca.if_else(diverged, WORST, density)
    output = all_moments if moments else log
    step = ca.Function("kalman", [state, exogenous, numbers], [following, output])
    return lanes.build_kernel(step, params=[*range(numbers.shape[0])], width=WIDTH, fused=True)


def observer_form_matrices(n: int, m: int, model: int, numbers: Any) -> tuple[Any, Any, Any, Any]:
    """Return F, B, the noise's G G' and H of the plant in observer form with its disturbance.

    Args:
        n, m, model: as for `build_kalman_kernel`.
        numbers: a (n), b (m n), then q^2, r^2, d_r, d_l, phi: CasADi expressions or numbers.

    Returns:
        F (size x size), B (size x m), G G' (size x size) for q = 1, H (1 x size).
    """
    size = n + (model > 0)
    zeros = type(numbers).zeros
    F = zeros(size, size)
    B = zeros(size, m)
    G = zeros(size, size)
    H = zeros(1, size)
    F[:n, :n] = ca.DM(np.eye(n, k=1))
    F[:n, 0] = -numbers[:n]
    B[:n, :] = ca.reshape(numbers[n : n + m * n], n, m)
    H[0, 0] = 1.0
    if model == WHITE:
        return F, B, B @ B.T, H
    F[n, n] = numbers[n + m * n + 4]
    G[n, n] = 1.0
    if model == AT_INPUT:
        F[:n, n] = B[:n, 0]
    else:
        H[0, n] = 1.0
    return F, B, G, H


# --- The records


class KalmanObjective:
    """Likelihood (L2) of a record for a single order and a single disturbance model.

    theta = [a, b, ln q, ln r, d_r, d_l, (atanh phi)].

    Args:
        data: the records.
        layout: order, inputs and integrators of the plant.
        model: WHITE, AT_INPUT or AT_OUTPUT.
        limits: prior limits of the widths.

    Attributes:
        log_q: place of ln q in theta; ln r, d_r, d_l and atanh phi follow.
        noise: places of the first four of these.
        size: number of parameters P.
    """

    gain = 2e-3

    def __init__(self, data: RecordData, layout: Layout, model: int, limits: WidthLimits) -> None:
        self.data = data
        self.layout = layout
        self.model = model
        self.limits = limits
        self.climbs = data.climbs
        self.log_q = layout.numerators.stop
        self.size = self.log_q + 4 + (model > 0)
        self.noise = slice(self.log_q, self.log_q + 4)
        starts = np.isin(np.arange(data.y.size), data.start)
        self.exogenous = np.column_stack([data.u, data.y, data.side, data.ok, starts])
        free = np.ones(self.size, bool)
        free[self.noise][2:] = limits.free
        self.free: Integers = np.flatnonzero(free)
        is_noise = np.isin(self.free, (self.log_q, self.log_q + 1))
        self.longest = np.where(is_noise, 1.0, np.inf)

    def can_run_filter(self, p: Floats) -> bool:
        """Return whether the filter can be run with these parameters."""
        if not np.isfinite(p).all():
            return False
        log_q, log_r, right, left = p[self.noise]
        if right + left < 0 or abs(log_q) > 25 or abs(log_r) > 25:
            return False
        if self.model and abs(p[-1]) > 4:
            return False
        poles = polynomial_roots(p[self.layout.denominator])
        return bool(np.abs(poles).max(initial=0.0) < 1 - 1e-4)

    def lane_numbers(self, p: Floats) -> Floats:
        """Return the lane parameters of `build_kalman_kernel` for p."""
        log_q, log_r, right, left = p[self.noise]
        left = right if self.limits.tied else left
        q = math.exp(log_q)
        r = max(math.exp(log_r), QUIETEST)
        phi = math.tanh(p[-1]) if self.model else 0.0
        stationary = q * q / max(1 - phi * phi, 1e-4)  # variance of the disturbance
        noise = [q * q, r * r, right, left, phi, 5.0, stationary]
        a = self.layout.full_denominator(p[self.layout.denominator])[1:]
        return np.concatenate([a, p[self.layout.numerators], noise])

    def log_densities(self, points: Floats) -> Floats:
        """Return log densities of the samples (K x N) for K parameter sets (K x P)."""
        logs = self.kernel_outputs(points)[:, :, 0]
        return np.nan_to_num(logs, nan=-1e3, posinf=-1e3, neginf=-1e3)

    def kernel_outputs(self, points: Floats, moments: bool = False) -> Floats:
        """Return the kernel's outputs (K x N x outputs) for K parameter sets (K x P)."""
        rows = np.array(list(map(self.lane_numbers, points)))
        kernel = build_kalman_kernel(self.layout.n, self.layout.m, self.model, moments)
        return estimates.run_lanes_along(kernel, self.exogenous, rows)[0]

    @estimates.cache_latest
    def densities_and_scores(self, p: Floats) -> tuple[Floats, Floats]:
        """Return log densities (N) and their derivatives by the free parameters (N x F)."""
        steps = self._score_steps(p)
        value, *perturbed = self.log_densities(estimates.perturb_each(p, self.free, steps))
        return value, estimates.central_differences(np.array(perturbed), steps).T

    def _score_steps(self, p: Floats) -> Floats:
        """Return the step of each free parameter for numerical scores (free)."""
        return STEP * np.maximum(np.abs(p[self.free]), 0.05)

    def total_log_likelihood(self, p: Floats) -> float:
        """Return the log likelihood; -inf if p is inadmissible."""
        if not self.can_run_filter(p):
            return -math.inf
        return float(self.densities_and_scores(p)[0].sum())

    def project_to_bounds(self, p: Floats) -> Floats:
        """Return the trial unchanged: inadmissible trials have no value."""
        return p

    def quadratic_model(self, p: Floats) -> tuple[float, Floats, Floats]:
        """Return value, score, and outer products of the scores, for the free parameters."""
        values, slopes = self.densities_and_scores(p)
        hessian = slopes.T @ slopes + 1e-9 * np.eye(self.free.size)
        return values.sum(), slopes.sum(axis=0), hessian

    def start_from_samples(self, fit: ZoneFit, share: float) -> Floats:
        """Return a start point (P) from a fit of single samples.

        Args:
            fit: the fit.
            share: share of its disturbance's power that the disturbance model produces. The rest is
                white noise.
        """
        p = np.zeros(self.size)
        p[: self.log_q] = fit.theta[: self.log_q]
        disturbance = math.sqrt(share) * fit.disturbance_rms
        white = max(math.sqrt(1 - share) * fit.disturbance_rms, 2 * QUIETEST)
        phi = min(max(fit.rho, 0.5), 0.99)
        colour = phi if self.model == AT_INPUT else 0.0
        layout, power = self.layout, 1.0  # of the disturbance at z for q = 1
        if self.model != AT_OUTPUT:
            power = input_noise_gain(p[layout.denominator], p[layout.numerators], layout.n, colour)
        if self.model:
            power /= 1 - phi * phi
        log_q = math.log(disturbance / math.sqrt(power))
        p[self.noise] = log_q, math.log(white), fit.right, fit.left
        if self.model:
            p[-1] = math.atanh(phi)
        return p

    def width_weights(self, right: float, left: float) -> Floats:
        """Return c (F) with c' theta_free = right d_r + left d_l."""
        place, tied = self.log_q + 2, self.limits.tied
        return estimates.weight_row(self.free, self.size, place, (right, left), tied)

    @estimates.cache_latest
    def robust_covariance(self, p: Floats) -> estimates.EstimateCovariance:
        """Return the robust covariance (I1) of the free parameters (F x F); cached.

        The Hessian consists of central differences of scores, which are central differences of log
        densities.
        """
        _, scores = self.densities_and_scores(p)
        outer = scores.T @ scores
        scale = 1 / np.sqrt(np.diag(outer) + 1e-12)
        steps = np.minimum(3e-2 * scale, 0.05)
        points = estimates.perturb_each(p, self.free, steps)[1:]
        small = self._score_steps(p)
        score_points = [estimates.perturb_each(point, self.free, small)[1:] for point in points]
        logs = self.log_densities(np.concatenate(score_points)).sum(axis=1)
        point_scores = estimates.central_differences(logs.reshape(len(points), -1).T, small).T
        hessian = -estimates.central_differences(point_scores, steps)
        if not np.isfinite(hessian).all():
            hessian = outer
        return estimates.sandwich_covariance(
            scores, estimates.raise_to_outer_products(hessian, outer)
        )
