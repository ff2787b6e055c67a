"""Inverse network: z as a function of the reading, discontinuous at y = 0."""

from __future__ import annotations

from typing import Any

import casadi as ca

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, require_positive
from undeadzone_arena.approximators import build_jump_functions
from undeadzone_arena.observers.parts.learned_residual import (
    LearnedOptions,
    WeightedFunctions,
    build_gradient_observer,
)


class InverseNetwork(LearnedOptions, frozen=True, kw_only=True, tag="inverse_network"):
    """Selmic and Lewis (2000), turned to a sensor: z_I = y / m + W'phi(y).

    Deadzone compensation in motion control systems using neural networks. phi are the jump
    functions (1 - e^(-|y| / scale))^k on each side. Silent samples are left out.

    References:
        R. R. Selmic, F. L. Lewis (2000), doi:10.1109/9.847098

    Attributes:
        scale: |y / m| over which the functions rise, one or one per output [z].
        functions: number of jump functions on each side.
    """

    scale: Array
    functions: int = 2

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        scale = require_positive("observer.scale", self.scale, model.p, "one per output")
        basis = build_jump_functions("observer.functions", self.functions)

        def psi(params: Any, y: Any, side: Any, z: Any) -> Any:
            """Return the jump functions of one output (N) [1]."""
            return basis.phi(params, ca.vertcat(y, side))

        compensator = WeightedFunctions(basis.params, psi, basis.size, True, scale)
        return build_gradient_observer(model, sensor, self, compensator, poles=30.0, gain=100.0)
