"""What is claimed, roughly, of what is unknown: all that a method of the arena is told, in place of the truth."""

from __future__ import annotations

import msgspec

from undeadzone.arrays import Array


class Declared(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Claims, in the words of `Censored`; with [model] and the sensor's noise all that a method of the arena is told.

    right, left: ranges [lo, hi] of d_r and d_l [z], one or one per output (left: default that of right). x_std: std of
    x(0), one or one per state (default: five times the largest width). disturbance: rms [u] of an input disturbance of that
    correlation_time [s] (default: a quarter period of the plant). bias: rms of a constant one [u]; calibrated: probability that it is only a tenth of that.
    tolerance: relative rms error of the model. drift: random walk of the widths [z / sqrt(s)].
    """

    right: Array
    left: Array | None = None
    x_std: Array | None = None
    disturbance: Array = 0.0
    correlation_time: float | None = None
    bias: Array = 0.0
    calibrated: float = 0.0
    tolerance: float = 0.0
    drift: float = 0.0
