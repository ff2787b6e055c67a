"""Assumptions, defaults, readings and estimates of the joint filters of the literature.

They see the dead zone as one function y / m = Dz(z, d_r, d_l) of `[x; d_r; d_l]`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.interfaces import Estimate, Reading
from undeadzone.nonlinearities import sensor as sensors
from undeadzone.nonlinearities.sensor import Zone, inverse
from undeadzone.numerics.gaussian import CLIP, TAIL
from undeadzone.observers.filtering.augmented_state import quarter_period, white_disturbance_rms
from undeadzone.observers.filtering.prior import (
    GLITCHES,
    Doubt,
    Prior,
    build_prior,
    read_width_ranges,
    require_sample_time,
)
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_nonnegative, require_number

CROWD = 100  # readings in a quarter period beyond which each is given more noise


class JointAssumptions(Options, frozen=True, kw_only=True):
    """Assumptions of the compared filters, in the words of `Kalman`.

    Missing ones follow from the method's defaults.

    Attributes:
        right, left: assumed ranges [lo, hi] of d_r and d_l, one or one per output [z] (left
            defaults to that of right).
        noise: rms of a reading, one or one per output [z] (default the sensor's, but at least the
            method's share of the assumed range).
        x_std: standard deviation of x(0) about 0, one or one per state (default the method's
            multiple of the largest width).
        disturbance: rms of an input disturbance that is new at every sample, one or one per input
            [u] (default the rms that moves z by `swing` times the largest width, rms, in a quarter
            period of the plant (in 50 samples for a chain of integrators)).
        swing: rms, in largest widths, by which the default disturbance moves z.
        drift: random walk of the widths [z / sqrt(s)] (default the method's multiple of the extent
            of each range).
        glitches: probability that a reading is wrong, for any sensor (0 trusts all readings, as
            published).
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    disturbance: Array | None = None
    swing: float = 0.1
    drift: float | None = None
    glitches: float = GLITCHES


class JointDefaults(NamedTuple):
    """Assumptions of a method if no option is given.

    If there are more than `CROWD` readings in a quarter period, the noise of each is increased so
    that together they contain no more information: errors of the model do not average out.

    Attributes:
        noise: least noise, as a share of the assumed range.
        drift: drift, in largest widths.
        x_std: standard deviation of x(0), in largest widths.
    """

    noise: float = 0.01
    drift: float = 0.005
    x_std: float = 5.0


STRICT = JointDefaults()  # of filters that no reading astride an edge misleads


class JointPrior(NamedTuple):
    """Prior of a joint filter.

    Attributes:
        prior: that of `[x; d_r; d_l]` and of the sensor.
        variance: that of the input disturbance (m) [u^2].
        ranges: assumed ranges of the widths (2p x 2) [z].
    """

    prior: Prior
    variance: Floats
    ranges: Floats


def build_joint_prior(
    assumptions: JointAssumptions,
    model: System,
    sensor: Zone,
    defaults: JointDefaults = STRICT,
    stride: int = 1,
) -> JointPrior:
    """Build the prior of a joint filter, with defaults for options that are not given.

    Args:
        assumptions: the options.
        model: the sampled model.
        sensor: the dead zone.
        defaults: the method's.
        stride: every how many samples a reading is used.

    Raises:
        InputError, ShapeError: for an impossible assumption, or a model in continuous time.
    """
    Ts = require_sample_time(model)
    readings = quarter_period(model) / (stride * Ts)
    ranges = read_width_ranges(assumptions.right, assumptions.left, model.p)
    largest = float(ranges.max())
    floor = defaults.noise * max(1.0, readings / CROWD) ** 0.5
    prior = build_prior(
        assumptions,
        model,
        sensor,
        floor=floor,
        reach=defaults.x_std,
        wear=defaults.drift,
    )
    swing = require_number("observer.swing", assumptions.swing, least=0.0)
    if assumptions.disturbance is None:
        rms = white_disturbance_rms(model, swing * largest)
    else:
        rms = require_nonnegative(
            "observer.disturbance", assumptions.disturbance, model.m, "one per input"
        )
    return JointPrior(prior, rms**2, ranges)


def zone_reading(kind: str, z: Any, right: Any, left: Any) -> Any:
    """Return the noise-free reading y / m of z by a sensor of that kind [z]."""
    if kind == "jump":
        return sensors.jump(z, right, left)
    return sensors.deadzone(z, right, left)


def numeric_estimate(
    X: Floats,
    z: Floats,
    reading: Reading,
    sensor: Zone,
    e: Floats,
    std: Floats,
    width_std: Floats,
    e_std: Floats,
) -> Estimate:
    """Build an `Estimate` of numbers.

    Args:
        X: `[x; d_r; d_l]` (n + 2p).
        z: output z^ (p).
        reading: the reading.
        sensor: the dead zone, for its slope and kind.
        e: innovation (p).
        std: standard deviations of X (n + 2p).
        width_std: standard deviations of d_r + d_l (p).
        e_std: standard deviations of e (p).
    """
    ends = [X.size - 2 * z.size, X.size - z.size]
    x, right, left = np.split(X, ends)
    x_std, right_std, left_std = np.split(std, ends)
    inverted = inverse(reading.y, reading.side, right, left, sensor.slope, sensor.kind)
    none = np.zeros(0)
    return Estimate(
        x,
        z,
        right,
        left,
        np.where(np.isfinite(reading.y), inverted, z),
        e,
        x_std,
        right_std,
        left_std,
        width_std,
        e_std,
        *[none] * (len(Estimate._fields) - 11),
    )


def glitch_probability(doubt: Doubt, e: Floats, std: Floats) -> Floats:
    """Return the probability that readings with these innovations are glitches (p) [1].

    Args:
        doubt: numbers of the doubt.
        e, std: innovations and their standard deviations (p) [z].
    """
    r = np.clip(e / std, -CLIP, CLIP)
    wrong = doubt.glitch - np.log(doubt.reach + TAIL * std)
    right = -(r**2) / 2 - np.log(2 * np.pi * std**2) / 2
    return np.asarray(1 / (1 + np.exp(right - wrong)))
