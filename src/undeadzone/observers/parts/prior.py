"""The prior of a filter: what it assumes of state, widths and sensor before the first reading."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.ends.gaps import largest_gap
from undeadzone.ends.sensor import Zone
from undeadzone.errors import InputError, ShapeError
from undeadzone.interfaces import Traits
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import state_units, time_scale
from undeadzone.support.arrays import Array, Floats, array, nonnegative, scalar, vector

FLOOR = 1e-3  # least noise that is assumed, in claimed ranges of the widths
SILENT = 4.0  # noise, in its rms, that is surely not beyond it
HELD = 6.0  # the same of what a play holds, which is met by many readings, hold after hold
REACH = 5.0  # standard deviation of x(0) as it shows in z, in largest widths, unless it is claimed


class Prior(NamedTuple):
    """Mean and spread of [x; d_r; d_l] (n + 2p) before the first reading, and the sensor's noise.

    Attributes:
        mean: mean of [x; d_r; d_l] (n + 2p).
        std: standard deviations of them (n + 2p).
        R: variance of a reading on an active side (p) [z^2].
        gate: |y| that is surely not silent (p) [y].
        drift: variance that the widths gain each step (2p) [z^2].
        worn: the same in squares of a range's extent; 0 where a drift is claimed.
        ranges: claimed ranges of all d_r, then of all d_l (2p x 2) [z].
        centre: mean and standard deviation of each d_r - d_l (p x 2) [z]; None: nothing but what
            the ranges say.
        largest: width that the ranges allow, or gap of a play ahead of the zone [z].
    """

    mean: Floats
    std: Floats
    R: Floats
    gate: Floats
    drift: Floats
    worn: float
    ranges: Floats
    centre: Floats | None = None
    largest: float = 0.0

    def widths(self) -> tuple[Floats, Floats]:
        """Mean (2p) and covariance (2p x 2p) of [d_r; d_l], with what is claimed of the centre."""
        n = self.mean.size - len(self.ranges)
        mean, cov = self.mean[n:], np.diag(self.std[n:] ** 2)
        if self.centre is None:
            return mean, cov
        p = len(self.centre)
        for i, (claimed, std) in enumerate(self.centre):
            h = np.eye(2 * p)[i] - np.eye(2 * p)[p + i]
            gain = cov @ h / (h @ cov @ h + std**2)
            mean = mean + gain * (claimed - h @ mean)
            cov = cov - np.outer(gain, h @ cov)
        return mean, (cov + cov.T) / 2


def build_prior(
    model: System,
    sensor: Zone,
    right: Array,
    left: Array | None,
    noise: Array | None,
    x_std: Array | None,
    drift: Array | None,
    *,
    floor: float = FLOOR,
    reach: float = REACH,
    wear: float = 0.0,
    start: Array = 0.0,
    centre: Array | None = None,
) -> Prior:
    """The prior from claimed ranges [lo, hi] of the widths.

    A width has the mean of its range, and the standard deviation of a uniform distribution over it.

    Args:
        model: the sampled model.
        sensor: the dead zone.
        right, left: claimed ranges of d_r, d_l; left None: those of right.
        noise: rms of a reading [z]; None: the sensor's, but at least `floor`.
        x_std: standard deviation of x(0); None: what shows as `reach` times the largest width
            (`state_units`).
        drift: random walk of the widths [z / sqrt(s)]; None: `wear` times the extent of each range
            in 1 / |pole|, which is 2 / pi quarter periods: who claims a narrow range claims that
            the width stays in it.
        floor: least noise, as a share of the claimed range.
        reach: standard deviation of x(0), in largest widths, where none is claimed.
        wear: drift, in extents of the range per 1 / sqrt(|pole|), where none is claimed.
        start: mean of x(0), one number or one per state.
        centre: claimed range of d_r - d_l, or its value; None: nothing is claimed.

    Raises:
        InputError, ShapeError: for a claim that cannot be, or a model in continuous time.
    """
    Ts = sample_time(model)
    p = model.p
    ranges = width_ranges(right, left, p)
    span = ranges[:, 1] - ranges[:, 0]
    largest = max(ranges[:, 1].max(), largest_gap(sensor.play))
    if noise is None:
        rms = sensor.rms
        least = floor * span.reshape(2, p).max(axis=0)
    else:
        rms = _claimed_noise(noise, p)
        least = np.zeros(p)
    if x_std is None:
        spread = reach * largest * state_units(model.flow or model.linear, Ts)
    else:
        spread = nonnegative("observer.x_std", x_std, model.n, "one per state")
    worn = 0.0
    if drift is None:
        worn = wear**2 * np.pi / 2 * Ts / time_scale(model.flow or model.linear, Ts)
    growth = scalar("observer.drift", 0.0 if drift is None else drift, least=0.0) ** 2 * Ts
    x0 = vector("observer.start", start, model.n, "one per state")
    return Prior(
        mean=np.concatenate([x0, ranges.mean(axis=1)]),
        std=np.concatenate([spread, span / np.sqrt(12)]),
        R=np.maximum(rms, least) ** 2,
        gate=silence_gate(sensor, rms),
        drift=growth + worn * span**2,
        worn=worn,
        ranges=ranges,
        centre=None if centre is None else _centres(centre, ranges, p),
        largest=largest,
    )


def silence_gate(sensor: Zone, rms: Floats) -> Floats:
    """|y| that is surely not silent (p) [y]; of a play, how far a held reading may be off.

    Args:
        sensor: the dead zone.
        rms: of a reading (p) [z].
    """
    noise = rms * sensor.slope
    return HELD * noise if sensor.kind == "play" else np.maximum(sensor.threshold, SILENT * noise)


def claimed_traits(prior: Prior, x_std: Array | None) -> Traits:
    """What verdicts may use of a filter's prior: a start and centres, where they are claimed.

    Args:
        prior: of the filter.
        x_std: as claimed; None: a default, which is no claim.
    """
    n = prior.mean.size - len(prior.ranges)
    return Traits(
        start_std=None if x_std is None else prior.std[:n],
        centre_std=None if prior.centre is None else prior.centre[:, 1],
    )


def _centres(claimed: Array, ranges: Floats, p: int) -> Floats:
    """Mean and standard deviation of each claimed d_r - d_l (p x 2). Raises InputError, ShapeError.

    A range stands for the uniform distribution over it.
    """
    value = array("observer.centre", claimed)
    if value.ndim == 0:
        value = np.full(2, float(value))
    if value.shape not in ((2,), (p, 2)):
        raise ShapeError(
            "observer.centre: expected the range [lo, hi] of d_r - d_l, its value, or one range "
            f"per output ({p} x 2), found {' x '.join(map(str, value.shape))}"
        )
    low, high = np.broadcast_to(value, (p, 2)).T
    least, most = ranges[:p, 0] - ranges[p:, 1], ranges[:p, 1] - ranges[p:, 0]
    if (low > high).any() or (high < least).any() or (low > most).any():
        raise InputError(
            "observer.centre: a range [lo, hi] of d_r - d_l must have lo <= hi and meet what the "
            f"ranges of d_r and d_l allow, {least.tolist()} to {most.tolist()}; found "
            f"{value.tolist()}"
        )
    return np.stack([(low + high) / 2, (high - low) / np.sqrt(12)], axis=1)


def _claimed_noise(noise: Array, p: int) -> Floats:
    """The claimed rms of a reading (p) [z]. Raises InputError where it is 0."""
    rms = nonnegative("observer.noise", noise, p, "one per output")
    if not rms.all():
        raise InputError(
            "observer.noise: must be positive, found 0; leave it out for a sensor without noise"
        )
    return rms


def sample_time(model: System) -> float:
    """The model's sample time [s]. Raises InputError in continuous time."""
    if model.Ts is None:
        raise InputError(
            'observer: this filter works on samples; set simulation.time = "sampled" '
            "(simulation.step is the sample time)"
        )
    return model.Ts


def width_ranges(right: Array, left: Array | None, p: int) -> Floats:
    """The claimed ranges of all d_r, then of all d_l (2p x 2) [z].

    Args:
        right, left: [lo, hi], or one per output (p x 2); left None: those of right.
        p: number of outputs.

    Raises:
        InputError, ShapeError: unless 0 <= lo < hi.
    """
    of_left = right if left is None else left
    return np.concatenate(
        [_ranges("observer.right", right, p), _ranges("observer.left", of_left, p)]
    )


def _ranges(key: str, value: Array, p: int) -> Floats:
    """The ranges of one side (p x 2). Raises InputError, ShapeError."""
    ranges = array(key, value)
    if ranges.shape not in ((2,), (p, 2)):
        shape = " x ".join(map(str, ranges.shape)) or "one number"
        raise ShapeError(
            f"{key}: expected the declared range [lo, hi], or one per output ({p} x 2), "
            f"found {shape}"
        )
    ranges = np.broadcast_to(ranges, (p, 2))
    if (ranges[:, 0] < 0).any() or (ranges[:, 0] >= ranges[:, 1]).any():
        raise InputError(f"{key}: a range [lo, hi] must have 0 <= lo < hi, found {ranges.tolist()}")
    return ranges
