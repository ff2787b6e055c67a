"""Choice of an observer from the assumptions (docs/methods/auto.md)."""

from __future__ import annotations

import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.censored import Censored
from undeadzone.observers.certified import Certified
from undeadzone.observers.filtering.prior import Assumptions, widths_within
from undeadzone.observers.filtering.signal_filter import build_signal_filter
from undeadzone.observers.high_gain import HighGain
from undeadzone.plants.system import System, fastest_pole

# Of `high_gain`, in times and rates of the plant's fastest pole, as the arena's tuning found them.
EPSILON = 0.25
GAMMA = 4.5


class Auto(Assumptions, frozen=True, kw_only=True, tag_field="method", tag="auto"):
    """Observer that suits the assumptions. Its options are those of `Assumptions`.

    Sampled: `censored`. Continuous: `certified` if disturbance, bias and tolerance are assumed to
    be 0 and the model is linear and stable, so that a proof exists, else `high_gain`.

    Example:
        >>> observer = uz.Auto(right=[0.0, 2.0], disturbance=0.2, bias=0.0)
        >>> observer.right
        [0.0, 2.0]

    See Also:
        Censored, Kalman, Certified
    """

    def choose_observer(self, model: System, sensor: Zone) -> Censored | Certified | HighGain:
        """Return the options of the observer that suits the assumptions.

        Raises InputError, ShapeError.
        """
        if model.Ts is not None:
            return Censored(**self.claims())
        widths = widths_within(self.right, self.left, model.p)
        stable = np.linalg.eigvals(model.linear.A).real.max() < 0
        if stable and not model.nonlinear and self.is_exact:
            return Certified(**widths)
        pole = fastest_pole(model)
        gamma = 0.0 if sensor.kind == "jump" else GAMMA * pole
        return HighGain(epsilon=EPSILON / pole, gamma=gamma, **widths)

    @property
    def is_exact(self) -> bool:
        """Return whether disturbance, bias and model error are all assumed to be 0."""
        assumptions = [self.disturbance, self.bias]
        if isinstance(self.tolerance, dict):
            assumptions.extend(self.tolerance.values())
        else:
            assumptions.append(self.tolerance)
        return not any(value is None or np.any(value) for value in assumptions)

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the chosen observer for a model, continuous or sampled."""
        if not model.m:
            return build_signal_filter(self, model, sensor)
        return self.choose_observer(model, sensor).build(model, sensor)
