"""Likelihoods of readings behind a dead zone, by single samples (L1) and by pairs (L2).

The plant puts out z; e is a Gaussian disturbance of rms s ahead of the zone. The reading is
y = z + e - d_r beyond the right edge, z + e + d_l beyond the left one, 0 between. docs/identify.md
derives the formulas.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

from undeadzone.util.arrays import Flags, Floats, Integers

Z, Z_BEFORE, RIGHT, LEFT, LOG_S, ATANH_RHO = range(6)  # columns of `DensityTerms.slopes`
LOG_ROOT = 0.5 * math.log(2 * math.pi)
ROOT = math.sqrt(2 * math.pi)
NARROW = 1e-5  # width of an interval below which its mass is width times density: no cancellation
FAR = -36.0  # limit below which a tail's mass underflows, so that its logarithm is computed
REACH = 7.0  # standard deviations beyond which a Gaussian is neglected: 2e-11 of its mass
STEEP = 0.7  # correlation above which the integral over innovations is the smoother one
# limits beyond ALL are infinite if the other variable is within NEAR: 7e-14
ALL = 8.0
NEAR = 3.0
NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)


class DensityTerms(NamedTuple):
    """Log densities of samples and their derivatives.

    Attributes:
        value: log density of each sample (N).
        slopes: derivatives (N x 6) by z_t, z_(t-1), d_r, d_l, log s and atanh rho.
    """

    value: Floats
    slopes: Floats


class Readings(NamedTuple):
    """Data of a record for the likelihoods.

    Attributes:
        y: readings (N), any number if missing.
        side: +1, -1 beyond the right or left edge, 0 inside the zone (N).
        ok: flags of the readings that are not missing (N).
        before: flags of the samples whose previous reading, in the same record, is there (N).
    """

    y: Floats
    side: Integers
    ok: Flags
    before: Flags


class ZoneNoise(NamedTuple):
    """Widths and noise of a zone: d_r, d_l, rms s of the disturbance, its correlation rho.

    rho is the correlation over one sample.
    """

    right: float
    left: float
    s: float
    rho: float


def root_mean_square(values: Floats) -> float:
    """Return the root of the mean square of all values.

    Args:
        values: any shape.
    """
    return float(np.sqrt(np.mean(values**2)))


def log_unit_density(x: Any) -> Any:
    """Return the log density of a standard Gaussian at x, NumPy's or CasADi's."""
    return -0.5 * x**2 - LOG_ROOT


def unit_density(x: Floats) -> Floats:
    """Return the density of a standard Gaussian at each x."""
    return np.exp(-0.5 * x**2) / ROOT


def dead_zone(z: Floats, right: float, left: float) -> Floats:
    """Return Dz(z) (N): the reading of z without noise."""
    return np.maximum(z - right, 0.0) + np.minimum(z + left, 0.0)


def zone_offset(side: Integers, right: float, left: float) -> Floats:
    """Return the offset that the zone subtracts on each branch (N): d_r right, -d_l left, 0
    inside.
    """
    return np.asarray(right * (side > 0) - left * (side < 0))


def zone_residual(readings: Readings, z: Floats, noise: ZoneNoise) -> Floats:
    """Return e outside the zone, y + d_r - z or y - d_l - z (N); y - z inside."""
    return readings.y + zone_offset(readings.side, noise.right, noise.left) - z


def single_densities(readings: Readings, z: Floats, noise: ZoneNoise) -> DensityTerms:
    """Return the log density (L1) of each sample by itself.

    Args:
        readings: the record.
        z: output of the plant (N).
        noise: widths and rms; rho is not used.

    Returns:
        Log densities and derivatives; 0 if a reading is missing.
    """
    value = np.zeros(z.size)
    slopes = np.zeros((z.size, 6))
    outside = readings.ok & (readings.side != 0)
    _enter_outside(readings, z, noise, np.flatnonzero(outside), value, slopes)
    inside = np.flatnonzero(readings.ok & (readings.side == 0))
    mass = _ZoneMass(z[inside], noise)
    value[inside] = mass.log
    slopes[inside, Z] = mass.by_z
    slopes[inside, RIGHT] = mass.by_right
    slopes[inside, LEFT] = mass.by_left
    slopes[inside, LOG_S] = mass.by_log_s
    return DensityTerms(value, slopes)


class _ZoneMass:
    """Log mass ln P(-d_l < z + e < d_r) and its derivatives, for an array of z."""

    def __init__(self, z: Floats, noise: ZoneNoise) -> None:
        a = (noise.right - z) / noise.s
        b = (-noise.left - z) / noise.s
        self.log = log_cdf_difference(a, b)
        at_a, at_b = limit_hazards(a, b, self.log)
        self.by_z = (at_b - at_a) / noise.s
        self.by_right = at_a / noise.s
        self.by_left = at_b / noise.s
        self.by_log_s = b * at_b - a * at_a


def _enter_outside(
    readings: Readings, z: Floats, noise: ZoneNoise, at: Integers, value: Floats, slopes: Floats
) -> None:
    """Write ln N(e; 0, s^2) and its derivatives for samples outside the zone (at), in place."""
    e = zone_residual(readings, z, noise)[at]
    side = readings.side[at]
    value[at] = -0.5 * (e / noise.s) ** 2 - math.log(noise.s) - LOG_ROOT
    by_e = -e / noise.s**2  # e = y + offset - z
    slopes[at, Z] = -by_e
    slopes[at, RIGHT] = by_e * (side > 0)
    slopes[at, LEFT] = -by_e * (side < 0)
    slopes[at, LOG_S] = (e / noise.s) ** 2 - 1


def densities_behind(
    readings: Readings, z: Floats, noise: ZoneNoise, zone: bool = True
) -> DensityTerms:
    """Return the log density N(y; Dz(z), s^2) of noise behind the zone.

    Args:
        readings: the record; sides are not used.
        z: output of the plant (N).
        noise: widths and rms.
        zone: whether there is a zone; else the readings are z - d_r.

    Returns:
        Log densities and derivatives; 0 if a reading is missing.
    """
    right = z > noise.right if zone else np.ones(z.size, bool)
    left = z < -noise.left if zone else ~right
    expected = dead_zone(z, noise.right, noise.left) if zone else z - noise.right
    e = (readings.y - expected) / noise.s
    by_z = e / noise.s
    slopes = np.zeros((z.size, 6))
    slopes[:, Z] = by_z * (right | left)
    slopes[:, RIGHT] = -by_z * right
    slopes[:, LEFT] = by_z * left
    slopes[:, LOG_S] = e**2 - 1
    value = -0.5 * e**2 - math.log(noise.s) - LOG_ROOT
    return DensityTerms(value * readings.ok, slopes * readings.ok[:, None])


def pair_densities(readings: Readings, z: Floats, noise: ZoneNoise) -> DensityTerms:
    """Return the log density (L2) of each sample given the previous; (L1) without a previous.

    Args:
        readings: the record.
        z: output of the plant (N).
        noise: widths, rms, and correlation rho of e over one sample.

    Returns:
        Log densities and derivatives; 0 if a reading is missing.
    """
    terms = single_densities(readings, z, noise)
    if noise.rho == 0.0 or not readings.before.any():
        return _add_slope_of_rho(readings, z, noise, terms)
    both = np.flatnonzero(readings.ok & readings.before)
    inside = readings.side[both] == 0
    inside_before = readings.side[both - 1] == 0
    _enter_outside_outside(readings, z, noise, both[~inside & ~inside_before], terms)
    _enter_inside_outside(readings, z, noise, both[inside & ~inside_before], terms)
    _enter_outside_inside(readings, z, noise, both[~inside & inside_before], terms)
    _enter_inside_inside(readings, z, noise, both[inside & inside_before], terms)
    return terms


def _add_slope_of_rho(
    readings: Readings, z: Floats, noise: ZoneNoise, terms: DensityTerms
) -> DensityTerms:
    """Add to (L1) the derivative of (L2) by atanh rho at rho = 0: the product of both scores
    by z.
    """
    both = np.flatnonzero(readings.ok & readings.before)
    terms.slopes[both, ATANH_RHO] = noise.s**2 * terms.slopes[both, Z] * terms.slopes[both - 1, Z]
    return terms


def _branch_indicators(readings: Readings, at: Integers) -> tuple[Floats, Floats]:
    """Return indicators of samples on the right branch and on the left branch."""
    return 1.0 * (readings.side[at] > 0), 1.0 * (readings.side[at] < 0)


def _enter_outside_outside(
    readings: Readings, z: Floats, noise: ZoneNoise, at: Integers, terms: DensityTerms
) -> None:
    """Write the terms of an outside sample after an outside sample, in place.

    ln N(e_t; rho e_(t-1), s'^2), s'^2 = s^2 (1 - rho^2).
    """
    rho = noise.rho
    innovation_share = 1 - noise.rho**2
    e = zone_residual(readings, z, noise)
    v = e[at] - rho * e[at - 1]  # innovation
    variance = noise.s**2 * innovation_share
    by_v = -v / variance
    excess = v**2 / variance - 1
    right, left = _branch_indicators(readings, at)
    right_before, left_before = _branch_indicators(readings, at - 1)
    slopes = terms.slopes
    terms.value[at] = -0.5 * v**2 / variance - 0.5 * math.log(variance) - LOG_ROOT
    slopes[at, Z] = -by_v
    slopes[at, Z_BEFORE] = rho * by_v
    slopes[at, RIGHT] = by_v * (right - rho * right_before)
    slopes[at, LEFT] = -by_v * (left - rho * left_before)
    slopes[at, LOG_S] = excess
    slopes[at, ATANH_RHO] = -rho * excess - by_v * e[at - 1] * innovation_share


def _enter_inside_outside(
    readings: Readings, z: Floats, noise: ZoneNoise, at: Integers, terms: DensityTerms
) -> None:
    """Write the terms of an inside sample after an outside sample, in place.

    ln{Phi((a_t - rho e)/s') - Phi((b_t - rho e)/s')}, with e that of the outside sample.
    """
    e = zone_residual(readings, z, noise)[at - 1]
    right, left = _branch_indicators(readings, at - 1)
    mass = _ConditionalMass(noise.right - z[at], -noise.left - z[at], e, noise)
    slopes = terms.slopes
    terms.value[at] = mass.log
    slopes[at, Z] = -mass.by_a - mass.by_b
    slopes[at, Z_BEFORE] = -mass.by_e
    slopes[at, RIGHT] = mass.by_a + mass.by_e * right
    slopes[at, LEFT] = -mass.by_b - mass.by_e * left
    slopes[at, LOG_S] = mass.by_log_s
    slopes[at, ATANH_RHO] = mass.by_rho


class _ConditionalMass:
    """Log mass ln{Phi((a - rho e)/s') - Phi((b - rho e)/s')} and its derivatives.

    It is ln P(b < e_t < a | e_(t-1) = e), for arrays a, b and e [z].
    """

    def __init__(self, a: Floats, b: Floats, e: Floats, noise: ZoneNoise) -> None:
        innovation_share = 1 - noise.rho**2
        spread = noise.s * math.sqrt(innovation_share)
        upper = (a - noise.rho * e) / spread
        lower = (b - noise.rho * e) / spread
        self.log = log_cdf_difference(upper, lower)
        at_upper, at_lower = limit_hazards(upper, lower, self.log)
        self.by_a = at_upper / spread
        self.by_b = -at_lower / spread
        self.by_e = -noise.rho * (self.by_a + self.by_b)
        self.by_log_s = lower * at_lower - upper * at_upper
        self.by_rho = -innovation_share * e * (self.by_a + self.by_b) - noise.rho * self.by_log_s


def _enter_outside_inside(
    readings: Readings, z: Floats, noise: ZoneNoise, at: Integers, terms: DensityTerms
) -> None:
    """Write the terms of an outside sample after an inside sample, in place.

    ln N(e; 0, s^2) + ln P(inside before | e) - ln P(inside before).
    """
    e = zone_residual(readings, z, noise)[at]
    right, left = _branch_indicators(readings, at)
    given_e = _ConditionalMass(noise.right - z[at - 1], -noise.left - z[at - 1], e, noise)
    before = _ZoneMass(z[at - 1], noise)
    slopes = terms.slopes  # of ln N(e; 0, s^2), by `single_densities`
    terms.value[at] += given_e.log - before.log
    slopes[at, Z] += -given_e.by_e
    slopes[at, Z_BEFORE] = -given_e.by_a - given_e.by_b - before.by_z
    slopes[at, RIGHT] += given_e.by_e * right + given_e.by_a - before.by_right
    slopes[at, LEFT] += -given_e.by_e * left - given_e.by_b - before.by_left
    slopes[at, LOG_S] += given_e.by_log_s - before.by_log_s
    slopes[at, ATANH_RHO] = given_e.by_rho


def _enter_inside_inside(
    readings: Readings, z: Floats, noise: ZoneNoise, at: Integers, terms: DensityTerms
) -> None:
    """Write the terms of an inside sample after an inside sample, in place.

    ln P(both inside) - ln P(inside before).
    """
    if not at.size:
        return
    s = noise.s
    rho = noise.rho
    a = (noise.right - z[at]) / s
    b = (-noise.left - z[at]) / s
    a0 = (noise.right - z[at - 1]) / s
    b0 = (-noise.left - z[at - 1]) / s
    log_both = log_rectangle_mass(a0, b0, a, b, rho)
    before = _ZoneMass(z[at - 1], noise)
    by_a, by_b = rectangle_edge_slopes(a, b, a0, b0, rho, log_both)
    by_a0, by_b0 = rectangle_edge_slopes(a0, b0, a, b, rho, log_both)
    slopes = terms.slopes
    terms.value[at] = log_both - before.log
    slopes[at, Z] = -(by_a + by_b) / s
    slopes[at, Z_BEFORE] = -(by_a0 + by_b0) / s - before.by_z
    slopes[at, RIGHT] = (by_a + by_a0) / s - before.by_right
    slopes[at, LEFT] = -(by_b + by_b0) / s - before.by_left
    slopes[at, LOG_S] = -(a * by_a + b * by_b + a0 * by_a0 + b0 * by_b0) - before.by_log_s
    slopes[at, ATANH_RHO] = (1 - rho**2) * rectangle_rho_slope(a0, b0, a, b, rho, log_both)


# --- Masses of Gaussians between limits, alone and in correlated pairs, as logarithms


def log_cdf_difference(a: Floats, b: Floats) -> Floats:
    """Return ln(Phi(a) - Phi(b)) without cancellation or underflow.

    Args:
        a, b: upper and lower limits (any shape), a > b.

    Returns:
        The logarithms; relative error near rounding wherever Phi(a) - Phi(b) > e^-700000.
    """
    flip = b > 0
    upper = np.where(flip, -b, a)
    lower = np.where(flip, -a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        value = np.log(_normal_cdf(upper) - _normal_cdf(lower))
    far = upper < FAR
    narrow = upper - lower < NARROW
    if far.any():
        top = log_ndtr(upper[far])
        bottom = log_ndtr(lower[far])
        value[far] = top + np.log(-np.expm1(np.minimum(bottom - top, -1e-300)))
    if narrow.any():
        width = np.maximum((upper - lower)[narrow], 1e-300)
        middle = 0.5 * (upper + lower)[narrow]
        # Second term of the midpoint rule for the Gaussian density.
        curvature = np.log1p(np.clip((middle**2 - 1) * width**2 / 24, -0.5, 0.5))
        value[narrow] = np.log(width) - 0.5 * middle**2 - LOG_ROOT + curvature
    return np.asarray(value)


def _normal_cdf(x: Floats) -> Floats:
    """Return Phi(x) (N, or N x K); a constant row, which is frequent, is computed once."""
    if x.ndim == 1:
        return np.asarray(ndtr(x))
    varies = (x != x[:, :1]).any(axis=1)
    value = np.repeat(ndtr(x[:, :1]), x.shape[1], axis=1)
    value[varies] = ndtr(x[varies])
    return value


def limit_hazards(a: Floats, b: Floats, log_mass: Floats) -> tuple[Floats, Floats]:
    """Return phi(a) and phi(b) over the mass between them, from the logarithm of that mass.

    Args:
        a, b: upper and lower limits (any shape).
        log_mass: ln(Phi(a) - Phi(b)).
    """
    at_a = np.exp(np.minimum(log_unit_density(a) - log_mass, 700.0))
    at_b = np.exp(np.minimum(log_unit_density(b) - log_mass, 700.0))
    return at_a, at_b


def log_rectangle_mass(a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float) -> Floats:
    """Return ln P(b0 < x0 < a0, b < x < a) of unit Gaussians x0, x with correlation rho.

    For a weak correlation the integral is over x0, for a strong one over the innovation x - rho x0:
    the integrand is then smooth on the scale of 1. Both integrands are log-concave, so only `REACH`
    about a point near their maximum is integrated.

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
    first = _has_no_bounds(a0, b0, a, b)
    second = ~first & _has_no_bounds(a, b, a0, b0)
    value[first] = log_cdf_difference(a[first], b[first])
    value[second] = log_cdf_difference(a0[second], b0[second])
    rest = ~(first | second)
    a0 = a0[rest]
    b0 = b0[rest]
    a = a[rest]
    b = b[rest]
    top = np.clip(
        rho * np.clip(0.0, b, a), b0, a0
    )  # near the maximum of the density in the rectangle
    over = _integrate_over_first if rho < STEEP else _integrate_over_innovation
    value[rest] = over(a0, b0, a, b, rho, top)
    return value


def _has_no_bounds(a0: Floats, b0: Floats, a: Floats, b: Floats) -> Flags:
    """Return flags of rectangles (N) whose limits b0 and a0 of x0 are practically infinite."""
    return (a0 > ALL) & (b0 < -ALL) & (a > -NEAR) & (b < NEAR)


def _integrate_over_first(
    a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float, top: Floats
) -> Floats:
    """Return ln int phi(x) {Phi((a - rho x)/q) - Phi((b - rho x)/q)} dx from b0 to a0 (N).

    q = sqrt(1 - rho^2). Arguments of `log_rectangle_mass`; top: place of the maximum (N).
    """
    q = math.sqrt(1 - rho**2)
    low = np.maximum(b0, top - REACH)
    high = np.minimum(a0, top + REACH)
    half = 0.5 * (high - low)
    x = 0.5 * (high + low)[:, None] + half[:, None] * NODES
    inside = log_cdf_difference((a[:, None] - rho * x) / q, (b[:, None] - rho * x) / q)
    logs = log_unit_density(x) + inside
    return _log_weighted_sum(logs, half[:, None] * WEIGHTS)


def _integrate_over_innovation(
    a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float, top: Floats
) -> Floats:
    """Return ln int phi(v) {Phi(x_high(v)) - Phi(x_low(v))} dv (N), v the scaled innovation.

    x = rho x0 + q v with q = sqrt(1 - rho^2) limits x0 to (x_low, x_high) for each v. The limits
    have kinks, at which the integral is split. Arguments of `log_rectangle_mass`; top: place of the
    maximum of x0 (N).
    """
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
    row = piece[:, 0]
    column = piece[:, 1]
    width = half[row, column]
    v = (ends[row, column] + width)[:, None] + width[:, None] * NODES
    x_high = np.minimum(a0[row, None], (a[row, None] - q * v) / rho)
    x_low = np.maximum(b0[row, None], (b[row, None] - q * v) / rho)
    logs = log_unit_density(v) + log_cdf_difference(x_high, np.minimum(x_low, x_high))
    parts = np.full(half.shape, -np.inf)
    parts[row, column] = _log_weighted_sum(logs, width[:, None] * WEIGHTS)
    return np.logaddexp(np.logaddexp(parts[:, 0], parts[:, 1]), parts[:, 2])


def _log_weighted_sum(logs: Floats, weights: Floats) -> Floats:
    """Return ln of the weighted sum of exponentials along the last axis."""
    largest = logs.max(axis=1, initial=-1e300)
    total = np.sum(weights * np.exp(logs - largest[:, None]), axis=1)
    with np.errstate(divide="ignore"):
        return np.maximum(largest + np.log(total), -1e300)


def rectangle_edge_slopes(
    a: Floats, b: Floats, other_a: Floats, other_b: Floats, rho: float, log_mass: Floats
) -> tuple[Floats, Floats]:
    """Return the derivatives of ln P(b < x < a, other_b < x' < other_a) by a and by b (N each).

    Args:
        a, b: limits of the unit Gaussian x (N).
        other_a, other_b: limits of x' (N).
        rho: correlation of both.
        log_mass: ln P (N).
    """
    spread = math.sqrt(1 - rho**2)
    slopes = []
    for edge in (a, b):
        inside = log_cdf_difference(
            (other_a - rho * edge) / spread, (other_b - rho * edge) / spread
        )
        log_slope = log_unit_density(edge) + inside - log_mass
        slopes.append(np.exp(np.minimum(log_slope, 700.0)))
    return slopes[0], -slopes[1]


def rectangle_rho_slope(
    a0: Floats, b0: Floats, a: Floats, b: Floats, rho: float, log_mass: Floats
) -> Floats:
    """Return the derivative of ln P(both inside) by rho: corner densities (Plackett 1954).

    References:
        R. L. Plackett (1954), doi:10.1093/biomet/41.3-4.351

    Args:
        a0, b0, a, b, rho: as for `log_rectangle_mass`.
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
