"""The test of a zone against none."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from undeadzone.identification.fit import Fit, climbed, fit_linear
from undeadzone.identification.objective import Objective

CHANCE = 0.01


class NoZone(NamedTuple):
    """The test's outcome.

    Attributes:
        chance: p of what was seen if there is no zone.
        fit: the fit with a zone, perhaps a better one than before.
        linear_share: 1 - rms error / rms of the readings, without a zone.
    """

    chance: float
    fit: Fit
    linear_share: float


def judge_no_zone(fit: Fit) -> NoZone:
    """Whether the readings need a zone at all.

    Args:
        fit: plant and zone.

    Returns:
        p by the likelihood ratio, made robust; 0 where exact zeros in number show the zone.
    """
    objective = fit.objective
    linear = fit_linear(objective.simulator, objective.readings.ok)
    error = (objective.data.y - linear.z)[objective.readings.ok]
    share = 1 - float(np.sqrt(np.mean(error**2)))
    if objective.kind != "behind":
        return NoZone(0.0, fit, share)
    best = _from_linear(objective, linear, fit)
    spread = best.objective.spread(best.theta)
    row = best.objective.direction(right=1.0, left=1.0)
    robust, naive = float(row @ spread.V @ row), float(row @ spread.naive @ row)
    ratio = 2 * max(best.value - linear.value, 0.0) / max(1.0, robust / max(naive, 1e-300))
    chance = float(chi2.sf(ratio, 2))
    if best.right + best.left <= spread.half_width(row):
        chance = max(chance, 0.05)
    return NoZone(chance, best, share)


def _from_linear(objective: Objective, linear: Fit, fit: Fit) -> Fit:
    """The fit, or a better one that starts at a small zone."""
    theta = linear.theta.copy()
    theta[objective.layout.right : objective.layout.right + 2] = 0.05
    top = climbed(objective, theta, 60)
    if math.isfinite(top.value) and top.value > fit.value:
        return Fit(objective, top.theta, top.value)
    return fit
