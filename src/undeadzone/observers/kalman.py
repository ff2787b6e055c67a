"""Measured-branch Kalman filter of `[x; d_r; d_l]`: exact if the branch of each reading is certain.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.filtering.augmented_state import power_of_two_units, white_disturbance_rms
from undeadzone.observers.filtering.gaussian_filter import white_disturbance
from undeadzone.observers.filtering.measured_kalman import build_branch_filter
from undeadzone.observers.filtering.prior import (
    GLITCHES,
    build_prior,
    outlier_probability,
    prior_traits,
)
from undeadzone.observers.filtering.unknown_inputs import resolve_input_rms
from undeadzone.plants.system import System, scale_states
from undeadzone.registry import Options
from undeadzone.util.arrays import Array

SWING = 0.2  # rms, in largest widths, by which the default disturbance moves z (docs/filters.md)


class Kalman(Options, frozen=True, kw_only=True, tag="kalman"):
    """Kalman filter on the measured branch (sampled time).

    A nonlinear model is expanded to second order.

    Example:
        >>> uz.Kalman(right=[0.0, 2.0], disturbance=0.2).right
        [0.0, 2.0]

    See Also:
        Auto, Censored, Luenberger

    Attributes:
        right, left: assumed ranges [lo, hi] of d_r and d_l, one or one per output [z] (left
            defaults to that of right).
        centre: assumed range [lo, hi] of (d_r - d_l)/2, a number if it is known (0: a symmetric
            zone), or one range per output [z] (default: the range that follows from those of d_r
            and d_l).
        noise: least rms of a reading on an active side, one or one per output [z] (default the
            sensor's): a larger one is learnt from the readings.
        x_std: standard deviation of x(0) about 0, one or one per state (default the deviation that
            appears in z as five times the largest width).
        disturbance: rms of an input disturbance that is new at every sample, one or one per input
            [u], default the rms that moves z by a fifth of the largest width in a quarter period,
            rms, so that readings count (the value 0 is an assumption as well, with which z^ soon
            follows the model alone).
        drift: random walk of the widths [z / sqrt(s)] (default 0).
        glitches: probability that a reading is wrong, for any sensor (0 trusts all readings, as
            textbooks do, and shows no wider intervals if they do not fit).
    """

    right: Array
    left: Array | None = None
    centre: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    disturbance: Array | None = None
    drift: float = 0.0
    glitches: float = GLITCHES

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the filter for a sampled model. Raises InputError for a jump sensor."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: readings of a jump sensor only bound its widths, which 'kalman' "
                "cannot use. Use 'censored'"
            )
        prior = build_prior(self, model, sensor, centre=self.centre)
        rms = resolve_input_rms(
            "disturbance", self.disturbance, white_disturbance_rms(model, SWING * prior.largest)
        )
        units = power_of_two_units(model)
        return build_branch_filter(
            model,
            units,
            sensor,
            prior,
            white_disturbance(scale_states(model, units), rms**2),
            outlier_probability(self.glitches),
            prior_traits(prior, self.x_std),
            recovers=False,
            learns_shape=False,
        )
