"""Likelihoods of readings behind a dead zone, sample by sample (L1).

The plant puts out z; e is a Gaussian disturbance of rms s ahead of the zone. The reading is
y = z + e - d_r beyond the right edge, z + e + d_l beyond the left one, 0 between. docs/identify.md
derives the formulas.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

from undeadzone.nonlinearities import sensor
from undeadzone.util.arrays import Flags, Floats, Integers

Z, RIGHT = range(2)  # columns of `DensityTerms.slopes`; those of d_l and log s follow
LOG_ROOT = 0.5 * math.log(2 * math.pi)
zone_offset = sensor.offset
NARROW = 1e-5  # width of an interval below which its mass is width times density: no cancellation
FAR = -36.0  # limit below which a tail's mass underflows, so that its logarithm is computed


class DensityTerms(NamedTuple):
    """Log densities of samples and their derivatives.

    Attributes:
        value: log density of each sample (N).
        slopes: derivatives (N x 4) by z, d_r, d_l and log s.
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
    """Widths and noise of a zone: d_r, d_l, and rms s of the disturbance."""

    right: float
    left: float
    s: float


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
    return np.exp(log_unit_density(x))


def dead_zone(z: Floats, right: float, left: float) -> Floats:
    """Return Dz(z) (N): the reading of z without noise."""
    return np.maximum(z - right, 0.0) + np.minimum(z + left, 0.0)


def mean_beyond_edges(z: Floats, noise: ZoneNoise) -> Floats:
    """Return the mean reading of each z (N) with noise ahead of the zone."""
    above, below = (z - noise.right) / noise.s, (-noise.left - z) / noise.s
    by_density = unit_density(above) - unit_density(below)
    return noise.s * (by_density + above * ndtr(above) - below * ndtr(below))


def zone_residual(readings: Readings, z: Floats, noise: ZoneNoise) -> Floats:
    """Return e outside the zone, y + d_r - z or y - d_l - z (N); y - z inside."""
    return readings.y + sensor.offset(readings.side, noise.right, noise.left) - z


def single_densities(readings: Readings, z: Floats, noise: ZoneNoise) -> DensityTerms:
    """Return the log density (L1) of each sample by itself.

    Args:
        readings: the record.
        z: output of the plant (N).
        noise: widths and rms.

    Returns:
        Log densities and derivatives; 0 if a reading is missing.
    """
    value = np.zeros(z.size)
    slopes = np.zeros((z.size, 4))
    outside = np.flatnonzero(readings.ok & (readings.side != 0))
    e = zone_residual(readings, z, noise)[outside]  # y + offset - z
    value[outside] = log_unit_density(e / noise.s) - math.log(noise.s)
    slopes[outside] = _gaussian_slopes(e / noise.s, e / noise.s**2, readings.side[outside])
    inside = np.flatnonzero(readings.ok & (readings.side == 0))
    a = (noise.right - z[inside]) / noise.s
    b = (-noise.left - z[inside]) / noise.s
    value[inside] = log_cdf_difference(a, b)
    at_a, at_b = limit_hazards(a, b, value[inside])
    by_widths = (at_b - at_a) / noise.s, at_a / noise.s, at_b / noise.s
    slopes[inside] = np.column_stack([*by_widths, b * at_b - a * at_a])
    return DensityTerms(value, slopes)


def _gaussian_slopes(e: Floats, by_z: Floats, side: Integers | Floats) -> Floats:
    """Return the derivatives of ln N(e; 0, 1) - ln s (n x 4).

    Args:
        e: residuals of samples outside the zone, over their rms s (n).
        by_z: e / s (n).
        side: +1 right, -1 left, 0 inside, where e does not depend on z (n).
    """
    return np.column_stack([by_z * (side != 0), -by_z * (side > 0), by_z * (side < 0), e**2 - 1])


def expected_reading(z: Floats, noise: ZoneNoise, zone: bool) -> Floats:
    """Return the readings of z (N) without the noise behind the zone.

    Args:
        z: output of the plant (N).
        noise: widths.
        zone: whether there is a zone; else the readings are z - d_r.
    """
    return dead_zone(z, noise.right, noise.left) if zone else z - noise.right


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
    side = sensor.zone(z, noise.right, noise.left) if zone else np.ones(z.size)
    e = (readings.y - expected_reading(z, noise, zone)) / noise.s
    slopes = _gaussian_slopes(e, e / noise.s, side)
    value = log_unit_density(e) - math.log(noise.s)
    return DensityTerms(value * readings.ok, slopes * readings.ok[:, None])


# --- Masses of a Gaussian between limits, as logarithms


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
        value = np.log(ndtr(upper) - ndtr(lower))
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
        value[narrow] = np.log(width) + log_unit_density(middle) + curvature
    return value


def limit_hazards(a: Floats, b: Floats, log_mass: Floats) -> tuple[Floats, Floats]:
    """Return phi(a) and phi(b) over the mass between them, from the logarithm of that mass.

    Args:
        a, b: upper and lower limits (any shape).
        log_mass: ln(Phi(a) - Phi(b)).
    """
    at_a, at_b = np.exp(np.minimum(log_unit_density(np.array([a, b])) - log_mass, 700.0))
    return at_a, at_b
