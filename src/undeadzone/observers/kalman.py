"""Measured-side Kalman filter on [x; d_r; d_l]: exact where the side of a reading is certain.

The mathematics is in docs/filters.md.
"""

from __future__ import annotations

from undeadzone.catalogue import Options
from undeadzone.ends.sensor import Zone
from undeadzone.errors import InputError
from undeadzone.interfaces import Observer
from undeadzone.observers.parts.augmented_state import agitation, even_units
from undeadzone.observers.parts.gaussian_filter import white
from undeadzone.observers.parts.measured_kalman import measured_filter
from undeadzone.observers.parts.prior import GLITCHES, build_prior, claimed_traits, glitch_share
from undeadzone.observers.parts.unknown_inputs import per_input
from undeadzone.plants.system import System, in_units
from undeadzone.support.arrays import Array

SWING = 0.2  # rms, in largest widths, by which the default disturbance moves z (docs/filters.md)


class Kalman(Options, frozen=True, kw_only=True, tag="kalman"):
    """Kalman filter on the measured side; sampled time.

    A nonlinear model is expanded to second order.

    Attributes:
        right, left: claimed ranges [lo, hi] of d_r and d_l, one or one per output [z]; left
            defaults to that of right.
        centre: claimed range [lo, hi] of (d_r - d_l)/2, a number where it is known (0: a symmetric
            zone), or one range per output [z]; default: what the ranges of d_r and d_l say.
        noise: rms of a reading on an active side, one or one per output [z]; default the sensor's.
        x_std: standard deviation of x(0) about 0, one or one per state; default what shows
            in z as five times the largest width.
        disturbance: rms of an input disturbance that is new at every sample, one or one per input
            [u]; default what moves z by a fifth of the largest width in a quarter period, rms, so
            that readings count; 0 is a claim, with which z^ soon follows the model alone.
        drift: random walk of the widths [z / sqrt(s)]; default 0.
        glitches: probability that a reading is wrong, whatever the sensor promises; 0 takes all
            readings for right, as textbooks do, and shows no wider intervals where they do not fit.
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
        """The filter for a sampled model."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: readings of a jump sensor only bound its widths, which 'kalman' "
                "cannot use; use 'censored'"
            )
        prior = build_prior(self, model, sensor, centre=self.centre)
        rms = per_input("disturbance", self.disturbance, agitation(model, SWING * prior.largest))
        units = even_units(model)
        return measured_filter(
            model,
            units,
            sensor,
            prior,
            white(in_units(model, units), rms**2),
            glitch_share(self.glitches),
            claimed_traits(prior, self.x_std),
            recovers=False,
        )
