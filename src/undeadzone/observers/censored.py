"""The Kalman filter that also hears silence, with coloured disturbance, bias and model tolerance (docs/filters.md)."""

from __future__ import annotations

import msgspec

from undeadzone.arrays import Array, nonnegative, scalar
from undeadzone.errors import InputError
from undeadzone.observers.filtering import measured_filter, prior
from undeadzone.observers.interface import Observer
from undeadzone.observers.unknowns import coloured, time_scale, tolerances, unknowns
from undeadzone.plant import System
from undeadzone.sensor import Zone


class Censored(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="censored"):
    """`Kalman` that also uses that a silent sensor bounds z, and knows what else may be wrong; sampled time.

    right, left, noise, x_std, drift: as for `Kalman`. disturbance: rms of a coloured input disturbance [u], one or one
    per input: first-order noise of that correlation_time [s] (default: a quarter period of the plant), or with a
    washout_time [s] one without constant part. bias: rms of an unknown constant at the input [u], one or one
    per input; calibrated: probability that it is only a tenth of that. tolerance: relative rms error of the model: of every
    entry of A and B but in rows that only say x_i' = x_j, or of some, as { "A[1,0]" = 0.1 }; of every parameter of a
    nonlinear plant. silence: false ignores the silent samples.
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    drift: float = 0.0
    disturbance: Array = 0.0
    correlation_time: float | None = None
    washout_time: float | None = None
    bias: Array = 0.0
    calibrated: float = 0.0
    tolerance: float | dict[str, float] = 0.0
    silence: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model. Raises InputError, ShapeError."""
        believed = prior(model, sensor, self.right, self.left, self.noise, self.x_std, self.drift)
        assert model.Ts is not None
        assert model.flow is not None
        correlation = time_scale(model.flow) if self.correlation_time is None else scalar("observer.correlation_time", self.correlation_time, above=0.0)
        washout = None if self.washout_time is None else scalar("observer.washout_time", self.washout_time, above=0.0)
        for key, value in (("correlation_time", correlation), ("washout_time", washout)):
            if value is not None and not 0.1 * model.Ts <= value <= 1e6 * model.Ts:
                raise InputError(f"observer.{key}: must lie between 0.1 and 1e6 sample times of {model.Ts:g} s, found {value:.4g} s")
        calibrated = scalar("observer.calibrated", self.calibrated, least=0.0)
        rms, bias = (nonnegative(f"observer.{key}", getattr(self, key), model.m, "one per input") for key in ("disturbance", "bias"))
        if calibrated >= 1 or (calibrated and not bias.any()):
            raise InputError(f"observer.calibrated: must be a probability below 1, and bias must be given, found {calibrated:g} with bias {bias.tolist()}")
        extension = unknowns(model, coloured(correlation, washout, model.Ts), rms, bias, calibrated, tolerances(model, self.tolerance))
        return measured_filter(model, sensor, believed, extension, max(1.0, correlation / model.Ts), self.silence)
