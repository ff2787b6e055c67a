"""Masses of Gaussians between limits, alone and in correlated pairs, as logarithms."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import log_ndtr

from undeadzone.identification.log import Flags
from undeadzone.support.arrays import Floats

LOG_ROOT = 0.5 * math.log(2 * math.pi)
NARROW = 1e-5  # intervals below this width are taken by the midpoint, where a difference cancels
REACH = 7.0  # standard deviations beyond which a Gaussian factor is left out: 2e-11 of its mass
STEEP = 0.7  # correlation from which the integral over innovations is the smoother one
ALL, NEAR = 8.0, 3.0  # limits beyond ALL hold all of x, given that the other is within NEAR: 7e-14
NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)


def log_difference(a: Floats, b: Floats) -> Floats:
    """ln(Phi(a) - Phi(b)) without cancellation or underflow.

    Args:
        a, b: upper and lower limits (any shape), a > b.

    Returns:
        The logarithms; relative error near rounding wherever Phi(a) - Phi(b) > e^-700000.
    """
    flip = b > 0
    upper = np.where(flip, -b, a)
    lower = np.where(flip, -a, b)
    top = log_ndtr(upper)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = top + np.log1p(-np.exp(log_ndtr(lower) - top))
    narrow = upper - lower < NARROW
    if narrow.any():
        width = np.maximum(upper - lower, 1e-300)
        middle = 0.5 * (upper + lower)
        bend = np.log1p(np.clip((middle**2 - 1) * width**2 / 24, -0.5, 0.5))
        value = np.where(narrow, np.log(width) - 0.5 * middle**2 - LOG_ROOT + bend, value)
    return value


def hazards(a: Floats, b: Floats, log_mass: Floats) -> tuple[Floats, Floats]:
    """phi(a) and phi(b) over the mass between them, from the logarithm of that mass.

    Args:
        a, b: upper and lower limits (any shape).
        log_mass: ln(Phi(a) - Phi(b)).
    """
    at_a = np.exp(np.minimum(-0.5 * a**2 - LOG_ROOT - log_mass, 700.0))
    at_b = np.exp(np.minimum(-0.5 * b**2 - LOG_ROOT - log_mass, 700.0))
    return at_a, at_b


def log_rectangle(a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float) -> Floats:
    """ln P(b0 < x0 < a0, b < x < a) of unit Gaussians x0, x with correlation rho.

    Weak correlations are integrated over x0, strong ones over the innovation x - rho x0, whichever
    integrand is smooth on the scale of 1; both are log-concave, so that `REACH` about a point near
    their top is all that counts.

    Args:
        a0, b0: upper and lower limits of x0 (N).
        a, b: of x (N).
        rho: correlation, |rho| < 1.

    Returns:
        The logarithms (N).
    """
    if rho < 0:
        a, b, rho = -b, -a, -rho
    value = np.empty(a.size)
    first = _bounds_nothing(a0, b0, a, b)
    second = ~first & _bounds_nothing(a, b, a0, b0)
    value[first] = log_difference(a[first], b[first])
    value[second] = log_difference(a0[second], b0[second])
    rest = ~(first | second)
    a0, b0, a, b = a0[rest], b0[rest], a[rest], b[rest]
    top = np.clip(rho * np.clip(0.0, b, a), b0, a0)  # of the density within the rectangle, nearly
    over = _over_first if rho < STEEP else _over_innovation
    value[rest] = over(a0, b0, a, b, rho, top)
    return value


def _bounds_nothing(a0: Floats, b0: Floats, a: Floats, b: Floats) -> Flags:
    """Where all of x0 lies between b0 and a0, given that x lies between b and a (N)."""
    return (a0 > ALL) & (b0 < -ALL) & (a > -NEAR) & (b < NEAR)


def _over_first(a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float, top: Floats) -> Floats:
    """ln int phi(x) {Phi((a - rho x)/q) - Phi((b - rho x)/q)} dx from b0 to a0."""
    q = math.sqrt(1 - rho**2)
    low, high = np.maximum(b0, top - REACH), np.minimum(a0, top + REACH)
    half = 0.5 * (high - low)
    x = 0.5 * (high + low)[:, None] + half[:, None] * NODES
    inside = log_difference((a[:, None] - rho * x) / q, (b[:, None] - rho * x) / q)
    logs = -0.5 * x**2 - LOG_ROOT + inside
    return _log_sum(logs, half[:, None] * WEIGHTS)


def _over_innovation(
    a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float, top: Floats
) -> Floats:
    """ln int phi(v) {Phi(x_high(v)) - Phi(x_low(v))} dv, x0 between the limits that v leaves it."""
    q = math.sqrt(1 - rho**2)
    peak = (np.clip(rho * top, b, a) - rho * top) / q
    low = np.maximum((b - rho * a0) / q, peak - REACH)
    high = np.minimum((a - rho * b0) / q, peak + REACH)
    kinks = np.sort(
        [np.clip((a - rho * a0) / q, low, high), np.clip((b - rho * b0) / q, low, high)], 0
    )
    ends = np.stack([low, kinks[0], kinks[1], high], axis=1)
    half = 0.5 * np.diff(ends, axis=1)
    piece = np.argwhere(half > 1e-14)
    row, column = piece[:, 0], piece[:, 1]
    width = half[row, column]
    v = (ends[row, column] + width)[:, None] + width[:, None] * NODES
    x_high = np.minimum(a0[row, None], (a[row, None] - q * v) / rho)
    x_low = np.maximum(b0[row, None], (b[row, None] - q * v) / rho)
    logs = -0.5 * v**2 - LOG_ROOT + log_difference(x_high, np.minimum(x_low, x_high))
    parts = np.full(half.shape, -np.inf)
    parts[row, column] = _log_sum(logs, width[:, None] * WEIGHTS)
    return np.logaddexp(np.logaddexp(parts[:, 0], parts[:, 1]), parts[:, 2])


def _log_sum(logs: Floats, weights: Floats) -> Floats:
    """ln of the weighted sum of exponentials along the last axis."""
    largest = logs.max(axis=1, initial=-1e300)
    total = np.sum(weights * np.exp(logs - largest[:, None]), axis=1)
    with np.errstate(divide="ignore"):
        return np.maximum(largest + np.log(total), -1e6)


def edge_slopes(
    a: Floats, b: Floats, other_a: Floats, other_b: Floats, rho: float, log_mass: Floats
) -> tuple[Floats, Floats]:
    """Derivatives of ln P(b < x < a, other_b < x' < other_a) by a and b, of unit Gaussians.

    Args:
        a, b: limits of x (N).
        other_a, other_b: limits of x' (N).
        rho: correlation of both.
        log_mass: ln P (N).
    """
    spread = math.sqrt(1 - rho**2)
    slopes = []
    for edge in (a, b):
        inside = log_difference((other_a - rho * edge) / spread, (other_b - rho * edge) / spread)
        log_slope = -0.5 * edge**2 - LOG_ROOT + inside - log_mass
        slopes.append(np.exp(np.minimum(log_slope, 700.0)))
    return slopes[0], -slopes[1]


def slope_of_rho(
    a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float, log_mass: Floats
) -> Floats:
    """Derivative of ln P(both inside) by rho: densities at the corners (Plackett 1954).

    Args:
        a0, b0, a, b, rho: as for `log_rectangle`.
        log_mass: ln P (N).
    """
    rest = 1 - rho**2
    log_scale = -math.log(2 * math.pi) - 0.5 * math.log(rest)
    slope = np.zeros(a.size)
    for x, sign in ((a0, 1.0), (b0, -1.0)):
        for x1, sign1 in ((a, 1.0), (b, -1.0)):
            square = (x**2 - 2 * rho * x * x1 + x1**2) / rest
            exponent = log_scale - 0.5 * square - log_mass
            slope += sign * sign1 * np.exp(np.minimum(exponent, 700.0))
    return slope
