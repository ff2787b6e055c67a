"""Extended Kalman filter on the measured side, for nonlinear models of several outputs.

Robot arms are among them (docs/methods/extended.md).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from undeadzone.catalogue import Options
from undeadzone.errors import InputError
from undeadzone.interfaces import Observer, Traits
from undeadzone.observers.parts.augmented_state import default_disturbance
from undeadzone.observers.parts.doubt import GLITCHES, glitch_share
from undeadzone.observers.parts.even_states import counted_prior, even_units, shown_states
from undeadzone.observers.parts.gaussian_filter import Augmentation
from undeadzone.observers.parts.judged_filter import judged
from undeadzone.observers.parts.measured_kalman import measured_filter
from undeadzone.observers.parts.model_tolerance import named
from undeadzone.observers.parts.prior import Prior, build_prior
from undeadzone.observers.parts.separate_joints import separate
from undeadzone.observers.parts.unknown_inputs import coloured, correlation_time, unknowns
from undeadzone.plants.system import System, in_units
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, Floats, nonnegative


class Extended(Options, frozen=True, kw_only=True, tag="extended"):
    """Kalman filter on the measured side whose model is linearised at the estimate.

    It is linearised sample by sample; sampled time.

    Attributes:
        right, left: claimed ranges [lo, hi] of d_r and d_l, one or one per output [z]; left
            defaults to that of right.
        centre: claimed range [lo, hi] of d_r - d_l, a number where it is known (0: a symmetric
            zone), or one range per output [z]; default: what the ranges of d_r and d_l say.
        noise: rms of a reading on an active side, one or one per output [z]; default the sensor's.
        start: mean of x(0), one or one per state; with a small x_std, what homing tells.
        x_std: standard deviation of x(0), one or one per state; default what shows in z as five
            times the largest width.
        disturbance: rms of an unknown input, one or one per input [u]; default what moves z by half
            of the largest width in a quarter period; 0 is a claim.
        correlation_time: correlation time of the disturbance, first-order noise [s]; default a 16th
            of the plant's period, 12.5 samples if it only integrates.
        drift: random walk of the widths [z / sqrt(s)]; default 0.
        glitches: probability that a reading is wrong, whatever the sensor promises; 0 takes all
            readings for right, as textbooks do, and shows no wider intervals where they do not fit.
            A blind filter takes all for right.
        uncertain: standard deviations of named parameters of the model, which become constant
            unknowns.
        silence: hear that a silent sensor bounds z, and that widths lie in their ranges.
        blind: take every reading for z, as if there were no dead zone.
        joints: "separate" keeps one covariance per joint of an arm [q; q'] whose positions are
            measured, to which the disturbance is an acceleration and all that a joint does not know
            of the others: much cheaper, and less is claimed.
    """

    right: Array
    left: Array | None = None
    centre: Array | None = None
    noise: Array | None = None
    start: Array = 0.0
    x_std: Array | None = None
    disturbance: Array | None = None
    correlation_time: float | None = None
    drift: float = 0.0
    glitches: float = GLITCHES
    uncertain: dict[str, float] = {}
    silence: bool = True
    blind: bool = False
    joints: Literal["coupled", "separate"] = "coupled"

    def build(self, model: System, sensor: Zone) -> Observer:
        """The filter for a sampled model."""
        if sensor.kind == "jump" and not (self.silence or self.blind):
            raise InputError(
                "observer.silence: readings of a jump sensor only bound its widths, so that "
                "without silence nothing tells of them"
            )
        prior = self._prior(model, sensor)
        Ts = model.Ts
        assert Ts is not None
        assert model.flow is not None
        correlation = correlation_time(self.correlation_time, model.flow, Ts)
        if self.disturbance is None:
            rms = default_disturbance(model, prior.ranges.max(), correlation)
        else:
            rms = nonnegative("observer.disturbance", self.disturbance, model.m, "one per input")
        # Joints that are filtered each for itself need [q; q'] as it is.
        units = np.ones(model.n) if self.joints == "separate" else even_units(model)
        even = in_units(model, units)
        augmentation = self._augmentation(even, correlation, rms, Ts)
        lasting = max(1.0, correlation / Ts)
        bounds = self.silence and not self.blind
        glitches = glitch_share(self.glitches)
        member = measured_filter(
            even,
            sensor,
            counted_prior(prior, units),
            augmentation,
            lasting,
            bounds,
            order=1,
            blind=self.blind,
            glitches=glitches,
            claimed=self.disturbance is not None,
            careful=self.x_std is None or self.disturbance is None,
        )
        traits = Traits(
            adapts=not self.blind,
            uncertain=tuple(self.uncertain),
            start_std=None if self.x_std is None else prior.std[: model.n],
            centre_std=None if prior.centre is None else prior.centre[:, 1],
        )
        judge = judged(member, even, glitches > 0 and not self.blind, traits)
        return shown_states(judge, units)

    def _prior(self, model: System, sensor: Zone) -> Prior:
        """The prior; of a blind filter, widths of 0. Raises InputError, ShapeError."""
        prior = build_prior(
            model,
            sensor,
            self.right,
            self.left,
            self.noise,
            self.x_std,
            self.drift,
            start=self.start,
            centre=self.centre,
        )
        if not self.blind:
            return prior
        n, none = model.n, np.zeros(2 * model.p)
        mean, std = np.append(prior.mean[:n], none), np.append(prior.std[:n], none)
        return prior._replace(mean=mean, std=std, drift=none, centre=None)

    def _augmentation(
        self, model: System, correlation: float, rms: Floats, Ts: float
    ) -> Augmentation:
        """The disturbance, and the uncertain parameters. Raises InputError."""
        colour = coloured(correlation, None, Ts)
        if self.joints == "separate":
            if self.uncertain:
                raise InputError(
                    "observer.uncertain: a parameter binds the joints together; "
                    'use joints = "coupled"'
                )
            return separate(model, colour, rms)
        no_bias = np.zeros(model.m)
        augmentation = unknowns(model, colour, rms, no_bias, 0.0, named(model, self.uncertain))
        places = tuple(model.names.index(name) for name in self.uncertain)
        return augmentation._replace(parameters=places)
