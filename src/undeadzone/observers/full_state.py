"""Reference line with full information: the true state serves as the estimate."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, build_estimate
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Floats


class FullState(Options, frozen=True, kw_only=True, tag="full_state"):
    """State feedback on the true state, with the true widths and without an observer.

    It exists in simulations only. Gaps of gears it takes from the model.
    """

    gears = True  # it knows them

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the reference line for a model, continuous or sampled."""

        def step(p: Params, s: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
            """Return the state, and the true state as an estimate.

            Raises InputError outside a simulation.
            """
            if reading.x is None:
                raise InputError(
                    "observer.method: 'full_state' needs the true state, which exists in a "
                    "simulation only. Choose an observer"
                )
            x = reading.x
            none = ca.SX.zeros(model.p)
            z = model.output(p.model, x)
            right = p.right
            left = p.left
            if model.gears is not None:
                right, left = model.gears.gap_widths(p.model)
            return s, build_estimate(x, z, right, left, reading, p.slope, sensor.kind, none)

        params = Params(model.params, sensor.right, sensor.left, sensor.slope)
        return Observer(params, lambda p: None, step, traits=Traits(adapts=False))


class Params(NamedTuple):
    """Parameters of the line: the model's, the true widths (p) [z], the slope (p)."""

    model: Any
    right: Floats
    left: Floats
    slope: Floats
