"""The classical Luenberger observer, blind to the dead zone: it takes the reading for the output."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, estimate
from undeadzone.linear.poles import observer_gain
from undeadzone.observers.parts.gain import gains
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, present
from undeadzone.support.arrays import Array, Floats


class Luenberger(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="luenberger",
):
    """x^' = A x^ + B u + L (y / m - C x^), Luenberger (1966): L (n x p) [1/s] as in `Certified`, or the poles of A - L C [1/s]."""

    L: Array | None = None
    poles: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, StructureError."""
        if self.poles is not None and self.L is None:
            L = observer_gain(model.linear, self.poles, model.Ts)
        elif self.L is not None and self.poles is None:
            L = gains(self.L, model) * (1.0 if model.Ts is None else model.Ts)
        else:
            raise InputError("observer: luenberger needs exactly one of L, poles")

        def step(p: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
            z = model.output(p.model, s.x)
            e = ca.if_else(present(reading.y), reading.y / p.slope - z, 0.0)
            none = ca.SX.zeros(model.p)
            return State(model.move(p.model, s.x, u) + p.L @ e), estimate(
                s.x, z, none, none, reading, p.slope, sensor.kind, e
            )

        def init(p: Params) -> State:
            return State(np.zeros(model.n))

        params = Params(model.params, L, sensor.slope)
        return Observer(params, init, step, traits=Traits(L=L, adapts=False))


class Params(NamedTuple):
    """Numbers of the observer; L is per step when the model is sampled."""

    model: Any
    L: Floats
    slope: Floats


class State(NamedTuple):
    """x^ alone."""

    x: Any
