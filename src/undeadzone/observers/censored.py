"""Kalman filter with censored samples, disturbance and model tolerance (docs/filters.md)."""

from __future__ import annotations

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.filtering.augmented_state import (
    default_disturbance_rms,
    power_of_two_units,
)
from undeadzone.observers.filtering.measured_kalman import build_branch_filter
from undeadzone.observers.filtering.prior import (
    Assumptions,
    build_prior,
    outlier_probability,
    prior_traits,
)
from undeadzone.observers.filtering.unknown_inputs import (
    OFFSET,
    build_colour,
    build_unknown_inputs,
    read_tolerance,
    resolve_correlation_time,
    resolve_input_rms,
)
from undeadzone.plants.system import System, scale_states
from undeadzone.util.arrays import require_number

WEAR = 0.0025  # default drift, in extents of the range per 1 / sqrt(|pole|)


class Censored(Assumptions, frozen=True, kw_only=True, tag_field="method", tag="censored"):
    """`Kalman` with bounds on z from a silent sensor, unknown inputs and model errors.

    Sampled time. Its further options are those of `Assumptions`. Defaults are cautious: the
    disturbance moves z by half of the largest width, rms, in a quarter period and the delay of the
    further poles, the bias is a quarter of it, widths walk by a 400th of their ranges' extent in 1
    / |pole|. The value 0 is an assumption as well.

    Example:
        >>> uz.Censored(right=[0.0, 2.0], disturbance=0.2).disturbance
        0.2

    See Also:
        Auto, Kalman, deadzone_update

    Attributes:
        levels: number of disturbance levels (rms) that are weighted by their likelihood (1 to 10).
            Three or more begin with four times the assumed rms, then the assumed one, and each
            further one is a quarter of the one before. Without an assumed rms they run from four
            times the default to an eighth of it. 1 takes the assumed or default rms as it is.
        silence: false ignores what silent samples bound, and the ranges but as a prior.
    """

    levels: int = 3
    silence: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the filter for a sampled model. Raises InputError, ShapeError."""
        prior = build_prior(
            self, model, sensor, wear=WEAR, centre=self.centre, silence=self.silence
        )
        Ts = model.Ts
        assert Ts is not None
        correlation = resolve_correlation_time(self.correlation_time, model.continuous, Ts)
        calibrated = require_number("observer.calibrated", self.calibrated, least=0.0)
        if calibrated >= 1:
            name = "observer.calibrated"
            raise InputError(f"{name}: must be a probability below 1, found {calibrated:g}")
        usual = default_disturbance_rms(model, prior.largest, correlation)
        rms = resolve_input_rms("disturbance", self.disturbance, usual)
        bias = resolve_input_rms("bias", self.bias, OFFSET * usual)
        colour = build_colour(correlation, Ts)
        units = power_of_two_units(model)
        tolerance = read_tolerance(model, self.tolerance, units)
        glitches = outlier_probability(self.glitches)
        careful = glitches > 0 and (self.x_std is None or self.disturbance is None)
        even = scale_states(model, units)
        augmentation = build_unknown_inputs(
            even, colour, rms, bias, calibrated, tolerance, careful and self.bias is None
        )
        return build_branch_filter(
            model,
            units,
            sensor,
            prior,
            augmentation,
            glitches,
            prior_traits(prior, self.x_std),
            lasting=max(1.0, correlation / Ts),
            bounds=self.silence,
            is_assumed=self.disturbance is not None,
            careful=careful,
            levels=self.levels,
        )
