"""The Kalman filter that also hears silence, with coloured disturbance, bias and model tolerance (docs/filters.md)."""

from __future__ import annotations

from functools import partial

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.observers.parts.augmented_state import presumed
from undeadzone.observers.parts.claims import Claims
from undeadzone.observers.parts.measured_kalman import Params, measured_filter, prior
from undeadzone.observers.parts.model_bank import bank
from undeadzone.observers.parts.unknown_inputs import (
    coloured,
    correlation_time,
    span,
    tolerances,
    unknowns,
)
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import nonnegative, scalar

OFFSET = 0.25  # bias, in disturbances, unless it is given
WEAR = 0.0025  # drift, in largest widths per sqrt(s), unless it is given
FALL = 4.0  # from one level of the disturbance to the next


class Censored(
    Claims,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="censored",
):
    """`Kalman` that also uses that a silent sensor bounds z, and knows what else may be wrong; sampled time.

    right, left, noise, x_std, drift: as for `Kalman`. disturbance: rms that a coloured input disturbance may have [u], one
    or one per input: first-order noise of that correlation_time [s] (default: a 16th of the plant's period; 1/4 s if it
    only integrates), or with a washout_time [s] one without constant part. levels: how many rms are weighed by what the readings say,
    each a quarter of the one before; 1 takes the given one. bias: rms of an unknown constant at the input [u], one or one
    per input; calibrated: probability that there is none. tolerance: relative rms error of the model: of every entry of A and B but
    in rows that only say x_i' = x_j, or of some, as { "A[1,0]" = 0.1 }; of every parameter of a nonlinear plant.
    silence: false ignores the silent samples, and the ranges but as a prior. Defaults doubt: the disturbance moves z by half of the largest width in a
    quarter period, rms, the bias is a quarter of it, widths walk by a 400th of the largest in 1 s; 0 is a claim.
    """

    washout_time: float | None = None
    levels: int = 3
    silence: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        believed = prior(
            model, sensor, self.right, self.left, self.noise, self.x_std, self.drift, wear=WEAR
        )
        Ts = model.Ts
        assert Ts is not None
        assert model.flow is not None
        correlation = correlation_time(self.correlation_time, model.flow, Ts)
        washout = None if self.washout_time is None else span("washout_time", self.washout_time, Ts)
        if not 1 <= self.levels <= 10:
            raise InputError(f"observer.levels: expected 1 to 10, found {self.levels}")
        calibrated = scalar("observer.calibrated", self.calibrated, least=0.0)
        if calibrated >= 1:
            raise InputError(
                f"observer.calibrated: must be a probability below 1, found {calibrated:g}"
            )
        usual = presumed(model, believed.ranges.max(), correlation)
        rms, bias = (
            default
            if given is None
            else nonnegative(f"observer.{key}", given, model.m, "one per input")
            for key, given, default in (
                ("disturbance", self.disturbance, usual),
                ("bias", self.bias, OFFSET * usual),
            )
        )
        colour, tolerance = coloured(correlation, washout, Ts), tolerances(model, self.tolerance)
        augmentation = unknowns(model, colour, rms, bias, calibrated, tolerance)
        found = measured_filter(
            model, sensor, believed, augmentation, max(1.0, correlation / Ts), self.silence
        )
        return (
            bank(found, [partial(weakened, level) for level in range(self.levels)])
            if self.levels > 1 and rms.any()
            else found
        )


def weakened(level: int, q: Params) -> Params:
    """The numbers of the filter with the disturbance at that level."""
    return q._replace(
        augmentation=q.augmentation._replace(variance=q.augmentation.variance / FALL ** (2 * level))
    )
