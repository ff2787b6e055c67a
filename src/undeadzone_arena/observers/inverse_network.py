"""An inverse network learns z as a function of the reading, which jumps at y = 0."""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, positive
from undeadzone_arena.approximators import jumps
from undeadzone_arena.observers.parts.learned_residual import (
    Compensator,
    LearnedOptions,
    by_gradient,
)


class InverseNetwork(LearnedOptions, frozen=True, kw_only=True, tag="inverse_network"):
    """Selmic and Lewis (2000), turned to a sensor: z_I = y / m + W'phi(y).

    Deadzone compensation in motion control systems using neural networks. phi are the jump
    functions (1 - e^(-|y| / scale))^k on each side. Silent samples are left out.

    Attributes:
        scale: |y / m| over which the functions rise, one or one per output [z].
        functions: number of jump functions on each side.
    """

    scale: Array
    functions: int = 2

    def build(self, model: System, sensor: Zone) -> Observer:
        """Return the observer for a model, continuous or sampled."""
        scale = positive("observer.scale", self.scale, model.p, "one per output")
        basis = jumps("observer.functions", self.functions)

        def psi(params: Any, y: Any, side: Any, z: Any) -> Any:
            return basis.phi(params, ca.vertcat(y, side))

        compensator = Compensator(basis.params, psi, basis.size, True, scale)
        return by_gradient(model, sensor, self, compensator, poles=30.0, gain=100.0)
