"""What is claimed of a plant and its sensor: options that several observers share.

A doubt says how far a filter believes its readings: a share of them is wrong, whatever the sensor
promises. The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import numpy as np

from undeadzone.ends.sensor import Zone
from undeadzone.errors import InputError
from undeadzone.numerics.gaussian import CLIP, TAIL
from undeadzone.observers.parts.prior import Prior
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import time_scale
from undeadzone.support.arrays import Array, Floats, scalar

GLITCHES = 0.05  # share of the readings that are wrong, unless it is claimed
REACH = 10.0  # largest claimed widths over which a glitch is spread
FAKE = 0.02  # share of the glitches that are a silence
SPAN = 2.0  # quarter periods of the plant over which innovations are summed
PATIENCE = 0.54  # quarter periods over which the share of refused readings is averaged
FEWEST = 6.0  # readings over which it is averaged at least
# Mean square of the sums of innovations that is taken for chance: where the disturbance is claimed,
# and where it is a default, whose colour is not that of the true one.
CHANCE, CHANCE_OF_DEFAULTS = 2.0, 4.0
HISTORY = 8.0  # quarter periods over which the squares of the sums are averaged


class Doubt(NamedTuple):
    """Numbers of the doubt about readings and claims.

    Attributes:
        glitch: log of the odds that a reading on an active side is wrong.
        fake: log of the probability that a silence is fake.
        reach: range over which a wrong reading is evenly spread (p) [z].
        noisy: 1 where two readings that are alike to the last digit show a stuck sensor (p).
        fade: share of the sum of innovations that is left after a step.
        keep: share of the mean of its squares that is left after a step.
        std: standard deviations of [x; d_r; d_l] before the first reading (n + 2p).
        forget: share of the mean share of refused readings that is left after a reading.
        most: mean square of the sums of innovations that is taken for chance.
    """

    glitch: Floats
    fake: Floats
    reach: Floats
    noisy: Floats
    fade: Floats
    keep: Floats
    std: Floats
    forget: Floats
    most: Floats


def doubt_numbers(
    model: System, sensor: Zone, prior: Prior, glitches: float, claimed: bool
) -> Doubt:
    """The numbers of the doubt.

    Args:
        model: the sampled model.
        sensor: the dead zone.
        prior: what the filter assumes before the first reading.
        glitches: probability that a reading is wrong; 0: none is.
        claimed: whether the disturbance is claimed, and no default.
    """
    assert model.flow is not None
    assert model.Ts is not None
    quarter = time_scale(model.flow, model.Ts)
    share = max(glitches, np.finfo(float).tiny)
    noisy = (sensor.noise > 0) | (sensor.noise_before > 0)
    return Doubt(
        glitch=np.log(share / (1 - share)),
        fake=np.log(FAKE * share),
        reach=glitch_reach(prior),
        noisy=1.0 * (noisy & (sensor.quantum == 0)),
        fade=np.exp(-model.Ts / (SPAN * quarter)),
        keep=np.exp(-model.Ts / (HISTORY * quarter)),
        std=prior.std,
        forget=np.exp(-1 / max(PATIENCE * quarter / model.Ts, FEWEST)),
        most=np.asarray(CHANCE if claimed else CHANCE_OF_DEFAULTS),
    )


def glitch_reach(prior: Prior) -> Floats:
    """The range over which a wrong reading is evenly spread (p) [z]."""
    return np.asarray(REACH * prior.ranges[:, 1].reshape(2, -1).max(axis=0))


def glitch_chance(doubt: Doubt, e: Floats, std: Floats) -> Floats:
    """The chance that readings with these innovations are glitches (p).

    Args:
        doubt: numbers of the doubt.
        e, std: innovations and their standard deviations (p) [z].
    """
    r = np.clip(e / std, -CLIP, CLIP)
    wrong = doubt.glitch - np.log(doubt.reach + TAIL * std)
    right = -(r**2) / 2 - np.log(2 * np.pi * std**2) / 2
    return np.asarray(1 / (1 + np.exp(right - wrong)))


def glitch_share(claimed: float) -> float:
    """The claimed probability of a wrong reading. Raises InputError."""
    share = scalar("observer.glitches", claimed, least=0.0)
    if share > 0.5:
        raise InputError(f"observer.glitches: must be at most 0.5, found {share:g}")
    return share


class Claims(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is claimed of a plant and its sensor; what is not claimed is doubted, and 0 is a claim.

    Attributes:
        right, left: ranges [lo, hi] of d_r and d_l, one or one per output [z]; left defaults to
            that of right.
        centre: claimed range [lo, hi] of d_r - d_l, a number where it is known (0: a symmetric
            zone), or one range per output [z]; default: what the ranges of d_r and d_l say.
        noise: rms of a reading on an active side, one or one per output [z]; default the sensor's.
        x_std: standard deviation of x(0) about 0, one or one per state; default what shows
            in z as five times the largest width.
        drift: random walk of the widths [z / sqrt(s)]; default a 400th of the range's extent
            in 1 / |pole| of the plant.
        disturbance: rms that a coloured input disturbance may have, one or one per input [u];
            default what moves z by half of the largest width, rms, in a quarter period of the
            plant and 1 / |pole| for each further pole.
        correlation_time: correlation time of the disturbance, first-order noise [s]; default a 16th
            of the plant's period, 12.5 samples if it only integrates.
        bias: rms of an unknown constant at the input, one or one per input [u]; default a quarter
            of the disturbance's.
        calibrated: probability that there is no bias.
        tolerance: relative rms error of the model: of every entry of A and B but in rows that only
            say x_i' = x_j, or of some, as { "A[1,0]" = 0.1 }; of every parameter of a nonlinear
            plant.
        glitches: probability that a reading is wrong, whatever the sensor promises; 0 takes all
            readings for right, as textbooks do, and shows no wider intervals where they do not fit.
    """

    right: Array
    left: Array | None = None
    centre: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: float | None = None
    disturbance: Array | None = None
    correlation_time: float | None = None
    bias: Array | None = None
    calibrated: float = 0.7
    tolerance: float | dict[str, float] = 0.05
    glitches: float = GLITCHES

    def claims(self) -> dict[str, Any]:
        """The claims by name."""
        return {name: getattr(self, name) for name in Claims.__struct_fields__}
