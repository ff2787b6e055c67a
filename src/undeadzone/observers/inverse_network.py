"""An inverse network with jump functions: it learns z as a function of the reading, which jumps at y = 0."""

from __future__ import annotations

from typing import Any

import casadi as ca
import msgspec

from undeadzone.interfaces import Observer
from undeadzone.numerics.approximators import jumps
from undeadzone.observers.parts.adaptive_laws import gradient
from undeadzone.observers.parts.gain import hiding, injection
from undeadzone.observers.parts.learned_residual import Compensator, learning
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import in_poles
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, positive


class InverseNetwork(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="inverse_network",
):
    """Selmic and Lewis, Deadzone compensation in motion control systems using neural networks (2000), turned to a sensor: z_I = y / m + W'phi(y).

    phi: `functions` jump functions (1 - e^(-|y| / scale))^k on each side; scale [z], one or one per output. L, poles
    [1/s] or speed [1/s]: of A - L C (default: a speed of 30 mean poles of the plant, fewer beyond second order); gain [1/s], leak: of the
    normalised gradient (default: 100 times the fastest pole) with e-modification; filtered: learn by the sensitivity
    of the error, so that fast poles do less harm; false is the law as published. Silent samples are left out.
    """

    scale: Array
    functions: int = 2
    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    gain: float | None = None
    leak: float = 0.0
    filtered: bool = True

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StructureError."""
        scale = positive("observer.scale", self.scale, model.p, "one per output")
        L = injection(model, self.L, self.poles, self.speed, hiding(model, 30.0))
        gain = in_poles(model, "observer.gain", self.gain, 100.0)
        basis = jumps("observer.functions", self.functions)

        def psi(params: Any, y: Any, side: Any, z: Any) -> Any:
            return basis.phi(params, ca.vertcat(y, side))

        law = gradient(model, gain, self.leak, basis.size)
        return learning(
            model,
            sensor,
            L,
            Compensator(basis.params, psi, basis.size, True, scale),
            law,
            filtered=self.filtered,
        )
