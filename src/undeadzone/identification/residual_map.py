"""What a fitted zone leaves of the readings, as a curve over z^ and over its direction."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr
from scipy.stats import f as fisher

from undeadzone.identification.fit import Fit
from undeadzone.identification.long_run import sandwich
from undeadzone.support.arrays import Floats

HATS = 8
COSINES = 24
SURE_SHARE = 0.1  # of the residual that a curve explains, from which it is another nonlinearity
LARGE_SHARE, LIKELY = 0.25, 0.01  # the same for a large share, of which p may be larger
SHARE, CHANCE = 0.05, 1e-3  # of the residual's variance, and p, from which a curve is real


class ResidualMap(NamedTuple):
    """The residual y - E[y | z^] by z^.

    Attributes:
        centres: places of the hat functions (K) [scaled z].
        curve, std: mean residual there, and its standard deviation (K) [scaled y].
        share, chance: share of the residual's variance that the curve explains, and its p.
        moving_share, moving_chance: the same for a curve times the direction of z^: a memory.
    """

    centres: Floats
    curve: Floats
    std: Floats
    share: float
    chance: float
    moving_share: float
    moving_chance: float

    @property
    def strange(self) -> bool:
        """Whether a map of z^ explains what a dead zone leaves."""
        return self.share > SHARE and self.chance < CHANCE

    @property
    def remembers(self) -> bool:
        """Whether the residual depends on the direction of z^."""
        return self.moving_share > SHARE and self.moving_chance < CHANCE


def expected_reading(fit: Fit) -> Floats:
    """E[y | z] (N): of the zone, rounded by noise ahead of it."""
    z, right, left, s = fit.z, fit.right, fit.left, fit.s
    if not fit.objective.limits.zone:
        return z
    if fit.objective.kind == "behind":
        return np.maximum(z - right, 0.0) + np.minimum(z + left, 0.0)
    a, b = (z - right) / s, (-left - z) / s
    return s * (_rounded(a) - _rounded(b))


def _rounded(x: Floats) -> Floats:
    """E max(x + e, 0) of a unit Gaussian e."""
    return np.exp(-0.5 * x**2) / math.sqrt(2 * math.pi) + x * ndtr(x)


def residual_map(fit: Fit) -> ResidualMap:
    """What the fit leaves, by z^ and by its direction.

    Args:
        fit: plant and zone of a record.

    Returns:
        The curve, how much it explains and how surely.
    """
    z = fit.z
    ok = fit.objective.readings.ok
    residual = fit.objective.readings.y - expected_reading(fit)
    centres = np.unique(np.quantile(z[ok], np.linspace(0.01, 0.99, HATS)))
    hats = _hats(z, centres)
    speed = np.diff(z, prepend=z[0])
    moving = hats * np.tanh(speed / (speed.std() + 1e-300))[:, None]
    curve, std, share, chance = explained(hats[ok], residual[ok])
    _, _, moving_share, moving_chance = explained(moving[ok], residual[ok])
    return ResidualMap(centres, curve, std, share, chance, moving_share, moving_chance)


def is_strange(share: float, chance: float) -> bool:
    """Whether a curve explains so much of a residual, and so surely, that the model is wrong."""
    sure = share > SURE_SHARE and chance < CHANCE
    return sure or (share > LARGE_SHARE and chance < LIKELY)


def curve_over(z: Floats, residual: Floats) -> tuple[float, float]:
    """The share of a residual that a curve over z explains, and p of it.

    Args:
        z: output of the plant (N).
        residual: what a model leaves (N).

    Returns:
        Share and p.
    """
    centres = np.unique(np.quantile(z, np.linspace(0.01, 0.99, HATS)))
    _, _, share, chance = explained(_hats(z, centres), residual)
    return share, chance


def _hats(z: Floats, centres: Floats) -> Floats:
    """Hat functions of z (N x K), one at each centre."""
    unit = np.eye(centres.size)
    return np.column_stack([np.interp(z, centres, row) for row in unit])


def explained(columns: Floats, residual: Floats) -> tuple[Floats, Floats, float, float]:
    """A residual by functions, by least squares.

    Args:
        columns: the functions (N x K).
        residual: what is to be explained (N).

    Returns:
        Coefficients, their deviations, the share explained, and p of a Wald test by (I1).
    """
    coefficients = np.linalg.lstsq(columns, residual, rcond=None)[0]
    left = residual - columns @ coefficients
    share = 1 - float(left @ left) / max(float(residual @ residual), 1e-300)
    normal = columns.T @ columns + 1e-9 * np.eye(columns.shape[1])
    spread = sandwich(columns * left[:, None], normal, COSINES)
    null = sandwich(columns * residual[:, None], normal, COSINES)
    count = columns.shape[1]
    wald = float(coefficients @ np.linalg.pinv(null.V) @ coefficients)
    degrees = max(COSINES - count + 1, 1)
    statistic = wald * degrees / (COSINES * count)
    std = np.sqrt(np.maximum(np.diag(spread.V), 0.0))
    return coefficients, std, share, float(fisher.sf(statistic, count, degrees))
