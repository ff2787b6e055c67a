"""Two positions with a load that floats between the flanks of a gap.

    y = R u + w + b,    |w| <= c / 2                                                         (P2)

A load with friction stays at the flank that pushed it last, which is the play of (P1). A load with
little friction flies from flank to flank when the motor slows down, so w depends on its dynamics.
The distribution of w identifies the gap nevertheless: w is at either flank, or uniform between
them. The rival is a linear plant between both positions, as a flexible shaft or a late encoder.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

from undeadzone.util.arrays import Floats
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.models.least_squares import Density, build_gaussian_density
from undeadzone_identify.models.lost_motion import LostMotion, Positions, Structure

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
        density: log densities of the readings.
        linear: density of the readings under a linear plant between both positions.
        contact: share of the samples at a flank.
    """

    found: LostMotion
    gap: Interval
    density: Density
    linear: Density
    contact: float

    @property
    def rivals(self) -> dict[str, Density]:
        """Return the densities of both models by the class of their verdict."""
        return {"play": self.density, "none": self.linear}


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
    noise = max(_white_rms(y - gain * u), least, 1e-9 * spread)

    def cost(at: Floats) -> float:
        return -float(_log_density(y - at[1] * gain * u - at[2] * spread, at, spread).sum())

    starts = [np.array([share, 1.0, 0.0, math.log(noise / spread), 0.0]) for share in STARTS]
    options = {"maxiter": 1200, "xatol": 1e-5, "fatol": 1e-3}
    minima = [minimize(cost, start, method="Nelder-Mead", options=options) for start in starts]
    at = min(minima, key=lambda minimum: float(minimum.fun)).x
    width = abs(float(at[0])) * spread
    gain = float(at[1]) * gain
    level = float(at[2]) * spread
    s = math.exp(float(at[3])) * spread
    w = y - gain * u - level
    value = _log_density(w, at, spread)
    visits = _visits(w, width)
    if min(len(visits[0]), len(visits[1])) < VISITS or width < APART * s:
        return None
    means = [np.array(positions) for positions in visits]
    scatter = math.sqrt(sum(float(positions.var(ddof=1)) / positions.size for positions in means))
    compliance = math.sqrt(max(s**2 - noise**2, 0.0))  # flanks yield under load
    rounding = math.hypot(data.quantum, gain * data.input_quantum)
    margin = math.hypot(2 * scatter, rounding)
    low = width - margin - 2 * compliance
    high = width + margin + compliance
    beyond = w - np.clip(w, -width / 2, width / 2)
    size = abs(gain)
    gap = Interval(width / size, max(low, 0.0) / size, high / size)
    offset = float(data.y.mean()) - gain * float(data.u.mean()) + level
    found = LostMotion(Structure(), gap.value, 0.0, 0.0, 0.0, gain, offset, beyond, NUMBERS)
    share = float(np.mean(np.abs(w) > (1 - CLOSE) * width / 2))
    return FreeLoad(
        found, gap, Density("play", value, NUMBERS, s), _linear_density(u, y, least), share
    )


def _log_density(w: Floats, at: Floats, scale: float) -> Floats:
    """Return log densities of w (N): a mixture of both flanks and the gap between, with noise.

    Args:
        w: position of the load in its gap (N) [y].
        at: c, R and b over their scales, logarithm of the noise, logit of the share of contact.
        scale: unit of c and of the noise [y].
    """
    half = abs(at[0]) * scale / 2
    s = math.exp(at[3]) * scale
    contact = 1 / (1 + math.exp(-at[4]))
    right = (w - half) / s
    left = (w + half) / s
    flank = (np.exp(-0.5 * right**2) + np.exp(-0.5 * left**2)) / (2 * s * math.sqrt(2 * math.pi))
    between = (ndtr(left) - ndtr(right)) / max(2 * half, 1e-3 * s)
    return np.asarray(np.log(contact * flank + (1 - contact) * between + 1e-300))


def _visits(w: Floats, width: float) -> tuple[list[float], list[float]]:
    """Return the mean of w at each visit of the left flank, and of the right flank [y].

    Args:
        w: position of the load in its gap (N) [y].
        width: width of the gap [y].
    """
    side = np.where(w > (1 - CLOSE) * width / 2, 1, np.where(w < (CLOSE - 1) * width / 2, -1, 0))
    touching = np.flatnonzero(side)
    if not touching.size:
        return [], []
    visits = np.split(touching, 1 + np.flatnonzero(np.diff(side[touching])))
    left, right = (
        [float(w[visit].mean()) for visit in visits if side[visit[0]] == flank] for flank in (-1, 1)
    )
    return left, right


def _linear_density(u: Floats, y: Floats, rounding_rms: float) -> Density:
    """Return the log densities of y under a linear plant between both positions.

    y is regressed on a constant and on lags and leads of u, as either position may lag the other.

    Args:
        u: position ahead of the gap (N) [u].
        y: position of the load (N) [y].
        rounding_rms: rms of the rounding error, below which no residual variance is credible [y].
    """
    padded = np.pad(u, LAGS, mode="edge")
    regressors = np.lib.stride_tricks.sliding_window_view(padded, 2 * LAGS + 1)
    regressors = np.column_stack([regressors, np.ones(y.size)])
    residual = y - regressors @ np.linalg.lstsq(regressors, y, rcond=1e-10)[0]
    variance = float(np.mean(residual**2)) + rounding_rms**2
    return build_gaussian_density("none", residual, regressors.shape[1] + 1, variance)


def _white_rms(w: Floats) -> float:
    """Return the rms of white noise in a signal (N), by its third differences."""
    return float(np.std(np.diff(w, 3)) / math.sqrt(20))
