"""The observer chosen from what is claimed (docs/methods/auto.md)."""

from __future__ import annotations

import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.observers.censored import Censored
from undeadzone.observers.certified import Certified
from undeadzone.observers.high_gain import HighGain
from undeadzone.observers.parts.claims import Claims
from undeadzone.observers.parts.measured_kalman import declared
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole
from undeadzone.sensor import Zone

EPSILON, GAMMA = (
    0.25,
    4.5,
)  # of `high_gain`, in times and rates of the plant's fastest pole, as the arena's tuning found them


class Auto(
    Claims, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="auto"
):
    """The observer that suits what is claimed; claims as for `Censored`.

    Sampled: `censored`. Continuous: `certified` where disturbance, bias and tolerance are claimed to be 0 and the model is
    linear and stable, so that there is a proof; else `high_gain`.
    """

    def chosen(self, model: System, sensor: Zone) -> Censored | Certified | HighGain:
        """The options of the chosen observer. Raises InputError, ShapeError."""
        if model.Ts is not None:
            return Censored(**self.claims())
        ranges = declared(self.right, self.left, model.p)
        guess, most = (
            ranges.mean(axis=1).reshape(2, model.p).T,
            ranges[:, 1].reshape(2, model.p).max(axis=0),
        )
        stable = np.linalg.eigvals(model.linear.A).real.max() < 0
        if stable and not model.nonlinear and self.exact:
            return Certified(widths0=guess, width_max=most)
        pole = fastest_pole(model)
        return HighGain(
            epsilon=EPSILON / pole,
            gamma=0.0 if sensor.kind == "jump" else GAMMA * pole,
            widths0=guess,
            width_max=most,
        )

    @property
    def exact(self) -> bool:
        """Whether disturbance, bias and error of the model are all claimed to be 0."""
        tolerance = (
            list(self.tolerance.values()) if isinstance(self.tolerance, dict) else [self.tolerance]
        )
        return not any(
            value is None or np.any(value) for value in (self.disturbance, self.bias, *tolerance)
        )

    def build(self, model: System, sensor: Zone) -> Observer:
        """The chosen observer for a model, continuous or sampled. Raises InputError and its kinds."""
        return self.chosen(model, sensor).build(model, sensor)
