"""Classical Luenberger observer: takes the reading for the output and ignores the dead zone."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, build_estimate
from undeadzone.linalg.poles import observer_gain
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.observers.adaptive.gain import innovation_gain
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats


class Luenberger(Options, frozen=True, kw_only=True, tag="luenberger"):
    """Observer x^' = A x^ + B u + L (y / m - C x^), Luenberger (1966), with L or poles.

    References:
        D. G. Luenberger (1966), doi:10.1109/TAC.1966.1098323

    Example:
        >>> uz.Luenberger(poles=[-2.0, -3.0]).poles
        [-2.0, -3.0]

    See Also:
        Kalman, Certified

    Attributes:
        L: gains (n x p) [1/s], as in `Certified`.
        poles: poles of A - L C (n) [1/s].
    """

    L: Array | None = None
    poles: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model, continuous or sampled."""
        L = self._luenberger_gain(model)

        def init(p: Params) -> State:
            """Return the state at t = 0: x^ = 0."""
            return State(np.zeros(model.n))

        def step(p: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
            """Return the state's derivative or next value, and the estimate."""
            z = model.output(p.model, s.x)
            e = ca.if_else(present(reading.y), reading.y / p.slope - z, 0.0)
            none = ca.SX.zeros(model.p)
            after = State(model.move_with_correction(p.model, s.x, u, p.L @ e))
            return after, build_estimate(s.x, z, none, none, reading, p.slope, sensor.kind, e)

        params = Params(model.params, L, sensor.slope)
        return Observer(params, init, step, traits=Traits(L=L, adapts=False))

    def _luenberger_gain(self, model: System) -> Floats:
        """Return L (n x p), per step if the model is sampled.

        Raises InputError, StructureError.
        """
        if self.poles is not None and self.L is None:
            return observer_gain(model.linear, self.poles, model.Ts)
        if self.L is not None and self.poles is None:
            return innovation_gain(self.L, model) * model.per_step
        raise InputError("observer: luenberger needs exactly one of L, poles")


class Params(NamedTuple):
    """Parameters of the observer. L (n x p) is per step if the model is sampled."""

    model: Any
    L: Floats
    slope: Floats


class State(NamedTuple):
    """State of the observer: x^ alone."""

    x: Any
