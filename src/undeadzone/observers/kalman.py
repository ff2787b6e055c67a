"""Measured-side Kalman filter on [x; d_r; d_l]: exact where the side of a reading is certain (docs/filters.md)."""

from __future__ import annotations

import msgspec

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.observers.parts.measured_kalman import measured_filter, prior, white
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, nonnegative


class Kalman(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="kalman",
):
    """Kalman filter on the measured side; sampled time. A nonlinear model is expanded to second order.

    right, left: declared ranges [lo, hi] of d_r and d_l [z], one or one per output (left: default that of right).
    noise: rms of a reading on an active side [z] (default: the sensor's). x_std: std of x(0) about 0, one or one per
    state (default: five times the largest width). disturbance: rms of an input disturbance that is new at every sample
    [u], one or one per input. drift: random walk of the widths [z / sqrt(s)].
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    disturbance: Array = 0.0
    drift: float = 0.0

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: readings of a jump sensor only bound its widths, which 'kalman' cannot use; use 'censored'"
            )
        believed = prior(model, sensor, self.right, self.left, self.noise, self.x_std, self.drift)
        variance = (
            nonnegative("observer.disturbance", self.disturbance, model.m, "one per input") ** 2
        )
        return measured_filter(model, sensor, believed, white(model, variance))
