"""Two positions with a load that floats between the flanks of a gap.

    y = R u + w + b,    |w| <= c / 2                                                         (P2)

A load with friction stays at the flank that pushed it last, which is the play of (P1). A load with
little friction flies from flank to flank when the motor slows down, so w depends on its dynamics.
The distribution of w identifies the gap nevertheless: w is at either flank, or uniform between
them. The rival is a linear plant between both positions, as a flexible shaft or a late encoder.
"""

from __future__ import annotations

import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, ndtr

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.least_squares import Density
from undeadzone_identify.models.likelihood import unit_density
from undeadzone_identify.models.lost_motion import (
    LostMotion,
    Positions,
    Structure,
    fit_plant,
    motion_density,
)

LAGS = 12  # lags and leads of u in the regression of a linear plant [samples]
NUMBERS = 6  # fitted parameters: c, R, b, the noise, the share of contact, and the variance of none
STARTS = (0.5, 1.0, 1.5)  # start values of the gap [range of w]
CLOSE = 0.25  # largest distance from a flank that counts as contact [half gaps]
VISITS = 6  # least number of visits to either flank
APART = 5.0  # least distance of the flanks [standard deviations of the noise]


class FreeLoad(NamedTuple):
    """Fit of (P2).

    Attributes:
        found: gap, gain and level; its residual is the part of w beyond the flanks.
        gap: c with its 95 % interval [u].
        rivals: log densities of the readings, and those under a linear plant between both
            positions, by the class of the verdict.
        contact: share of the samples at a flank.
    """

    found: LostMotion
    gap: Interval
    rivals: dict[str, Density]
    contact: float


def fit_free_load(data: Positions) -> FreeLoad | None:
    """Fit a load that floats in a gap, by maximum likelihood of the distribution of w.

    Args:
        data: the positions, at equidistant times.

    Returns:
        The fit; None if the load visited a flank too rarely, or if noise hides the flanks.
    """
    u = data.u - data.u.mean()
    y = data.y - data.y.mean()
    gain = float(u @ y / (u @ u))
    spread = float(np.ptp(y - gain * u))
    if spread <= 0:
        return None
    least = math.hypot(data.quantum, gain * data.input_quantum) / math.sqrt(12)
    noise = max(float(np.std(np.diff(y - gain * u, 3))) / math.sqrt(20), least, 1e-9 * spread)

    def cost(at: Floats) -> float:
        return -float(_log_density(y - at[1] * gain * u - at[2] * spread, at, spread).sum())

    begun = [[share, 1.0, 0.0, math.log(noise / spread), 0.0] for share in STARTS]
    options = {"maxiter": 1200, "xatol": 1e-5, "fatol": 1e-3}
    minima = [minimize(cost, start, method="Nelder-Mead", options=options) for start in begun]
    at = min(minima, key=attrgetter("fun")).x
    size, steeper, shift, log_s, _ = at.tolist()
    width = abs(size) * spread
    gain = steeper * gain
    level = shift * spread
    s = math.exp(log_s) * spread
    w = y - gain * u - level
    value = _log_density(w, at, spread)
    side = np.sign(w) * (np.abs(w) > (1 - CLOSE) * width / 2)
    means = _mean_of_visits(w, side)
    visits = [means[means < 0], means[means > 0]]
    if min(one.size for one in visits) < VISITS or width < APART * s:
        return None
    scatter = math.sqrt(sum(float(one.var(ddof=1)) / one.size for one in visits))
    compliance = math.sqrt(max(s**2 - noise**2, 0.0))  # flanks yield under load
    rounding = math.hypot(data.quantum, gain * data.input_quantum)
    margin = math.hypot(2 * scatter, rounding)
    beyond = w - np.clip(w, -width / 2, width / 2)
    low = max(width - margin - 2 * compliance, 0.0)
    gap = Interval(width, low, width + margin + compliance).scale_by(1 / abs(gain))
    offset = float(data.y.mean()) - gain * float(data.u.mean()) + level
    found = LostMotion(Structure(), gap.value, 0.0, 0.0, 0.0, gain, offset, beyond, NUMBERS)
    linear = fit_plant(data, found, range(-LAGS, LAGS + 1))
    rivals = {
        "play": Density("play", value, NUMBERS, s),
        "none": motion_density("none", linear, least),
    }
    return FreeLoad(found, gap, rivals, float(np.mean(side != 0)))


def _log_density(w: Floats, at: Floats, scale: float) -> Floats:
    """Return log densities of w (N): a mixture of both flanks and the gap between, with noise.

    Args:
        w: position of the load in its gap (N) [y].
        at: c, R and b over their scales, logarithm of the noise, logit of the share of contact.
        scale: unit of c and of the noise [y].
    """
    half = abs(at[0]) * scale / 2
    s = math.exp(at[3]) * scale
    contact = expit(at[4])
    sides = (w + half * np.array([[-1.0], [1.0]])) / s
    flank = unit_density(sides).mean(axis=0) / s
    between = np.diff(ndtr(sides), axis=0)[0] / max(2 * half, 1e-3 * s)
    return np.log(contact * flank + (1 - contact) * between + 1e-300)


def _mean_of_visits(w: Floats, side: Floats) -> Floats:
    """Return the mean of w at each visit of a flank [y].

    Args:
        w: position of the load in its gap (N) [y].
        side: -1 at the left flank, +1 at the right one, 0 between them (N).
    """
    touching = np.flatnonzero(side)
    begun = np.flatnonzero(np.diff(side[touching], prepend=0))
    return np.add.reduceat(w[touching], begun) / np.diff(begun, append=touching.size)
