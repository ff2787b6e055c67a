"""Level of the sensor's noise as an unknown of a filter: one factor for each output.

A reading has the variance v R, R as declared. An innovation e of variance S, of which v R is the
share r, has the score r (e^2 / S - 1) / 2 and the information r^2 / 2 about ln v. The recursion
adds the score over the summed information (docs/filter_equations.md, "Noise level").
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.numerics.gaussian import TAIL, RobustUpdate, normal_density
from undeadzone.observers.filtering.gaussian_filter import Params, Setup
from undeadzone.observers.filtering.prior import HOLD, SILENT, Prior
from undeadzone.util.arrays import Floats

# Half and double of each (of DOUBTED in its logarithm) were run on 64 problems of orders 1 and 2 in
# every world of benchmarks `sensor_shapes` that the number concerns, told and with ranges alone. No
# median deviation changes by more than 2 %, none of an error of z by more than 1.3 %.
# Half of DOUBTED flags noise x 5 in 0.23 and 0.11 of the runs (else 0.09 and 0.02), double in 0.05
# and 0.02.
DOUBTED = 2.0  # factor by which a declared rms may be off, one standard deviation
# 0.5 to 10 % of a range: 0.95 to 1.00 of the intervals hold with either.
LEFT_OUT = (5.0, 100.0)  # rms over its floor, evenly spread in its logarithm, if none is declared
LEAST = 0.25  # least v, from which evidence still raises it: no number changes
# Coverage changes by 0.02 at most.
WIDE = 2.0  # deviations of ln v by which a reading is unlikely before it counts as a glitch


class Level(NamedTuple):
    """State of the recursion.

    Attributes:
        factor: estimate of v (p) [1].
        known: information about ln v, with that of the prior (p).
    """

    factor: Any
    known: Any


class LevelNumbers(NamedTuple):
    """Parameters of a filter for the level of its noise.

    Attributes:
        start: v before the first reading (p) [1].
        first: information about ln v before the first reading (p).
        gate: |y| that is surely not silent, for the declared noise (p) [y].
    """

    start: Floats
    first: Floats
    gate: Floats


def level_numbers(setup: Setup, prior: Prior) -> LevelNumbers:
    """Return the parameters of the level, from a noise that is declared or left out."""
    times = HOLD if setup.is_backlash_sensor else SILENT
    low, high = 2 * np.log(LEFT_OUT)
    std = np.where(prior.declared, 2 * np.log(DOUBTED), (high - low) / np.sqrt(12))
    return LevelNumbers(
        start=np.exp(np.where(prior.declared, 0.0, (low + high) / 2)),
        first=1 / std**2,
        gate=times * np.sqrt(prior.R) * setup.sensor.slope,
    )


def start_level(q: Params) -> Level:
    """Return the level before the first reading, empty for a filter that trusts its noise."""
    if q.level is None:
        return Level(np.zeros(0), np.zeros(0))
    return Level(q.level.start, q.level.first)


def scale_noise(q: Params, level: Level) -> Params:
    """Return the filter's numbers for readings of the learnt variance, never below the declared.

    A noise as declared, and one of unknown level, have even odds before the readings, so that
    chance does not raise it. The gate has room for a further standard deviation of ln v.
    """
    if q.level is None:
        return q
    log = ca.log(ca.fmax(level.factor, 1.0))
    declared = ca.sqrt(level.known / q.level.first) * ca.exp(-level.known * log**2 / 2)
    factor = ca.exp(log / (1 + declared))
    above = ca.fmax(level.factor * ca.exp(1 / ca.sqrt(level.known)) - 1, 0.0)
    q = q._replace(R=factor * q.R, gate=ca.fmax(q.gate, q.level.gate * ca.sqrt(above)))
    if q.ends is None:
        return q
    return q._replace(ends=q.ends._replace(gate=ca.sqrt(factor) * q.ends.gate))


def update_level(q: Params, level: Level, declared: Any, read: RobustUpdate, counted: Any) -> Level:
    """Return the level after the readings of a sample.

    A reading that would be a glitch even if the noise were much larger is no evidence. Other
    readings, repeats among them, leave the level unchanged.

    Args:
        q: the filter's numbers, R as it was used.
        level: before the readings.
        declared: variances of the readings (p) [z^2].
        read: innovations and their deviations.
        counted: whether each reading has the noise of this level (p).
    """
    if q.level is None:
        return level
    R = level.factor * declared
    S = ca.fmax(read.std**2 - q.R, 0.0) + R
    share = R / S
    more = R * (ca.exp(WIDE / ca.sqrt(level.known)) - 1)
    wide = S + more
    likely = normal_density(read.e / ca.sqrt(wide)) / ca.sqrt(wide)
    glitch = ca.exp(q.doubt.glitch) / (q.doubt.reach + TAIL * ca.sqrt(S))
    weight = counted * likely / (likely + glitch)
    faded = q.level.first + q.doubt.keep * (level.known - q.level.first)
    known = ca.if_else(counted, faded, level.known)
    most = known + weight * ((R + more) / wide) ** 2 / 2
    move = weight * share * (read.e**2 / S - 1) / 2 / most
    factor = level.factor * ca.if_else(move > 0, 1 + move, 1 / (1 - move))
    return Level(ca.fmax(factor, LEAST), known + weight * share**2 / 2)
