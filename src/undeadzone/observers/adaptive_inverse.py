"""The adaptive deadzone inverse: an observer fed with y / m + chi_bar d^, whose widths learn from its error."""

from __future__ import annotations

from typing import Any, Literal

import casadi as ca
import msgspec
import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.observers.parts.adaptive_laws import gradient, least_squares
from undeadzone.observers.parts.gain import hiding, injection
from undeadzone.observers.parts.learned_residual import Compensator, learning
from undeadzone.observers.parts.widths import bounded_widths
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import in_poles
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array


class AdaptiveInverse(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="adaptive_inverse",
):
    """Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities (1996), here as an observer.

    L, poles [1/s] or speed [1/s]: of A - L C (default: a speed of 30 mean poles of the plant, fewer beyond second order). law: normalised
    gradient or recursive least squares; gain: of the gradient [1/s], or the initial spread (default: 300 times the
    fastest pole); forgetting [1/s]: of least squares. silent: "hold" corrects and learns on an active side only, "zero" is the literal inverse,
    which takes silence for z = 0. widths0: d^(0) (p x 2) [z]; width_max: d_M per side, which projection keeps.
    """

    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    law: Literal["gradient", "least_squares"] = "gradient"
    gain: float | None = None
    forgetting: float = 2.5
    silent: Literal["hold", "zero"] = "hold"
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StructureError."""
        p = model.p
        widths, limit = bounded_widths(self.widths0, self.width_max, p)
        L = injection(model, self.L, self.poles, self.speed, hiding(model, 30.0))
        gain = in_poles(model, "observer.gain", self.gain, 300.0)

        def psi(params: Any, y: Any, side: Any, z: Any) -> Any:
            return ca.vertcat(side > 0, -(side < 0))

        law = (
            gradient(model, gain, 0.0, 2)
            if self.law == "gradient"
            else least_squares(model, gain, self.forgetting, 2)
        )
        compensator = Compensator(None, psi, 2, self.silent == "hold", np.ones(p))
        return learning(
            model, sensor, L, compensator, law, filtered=True, W0=widths.ravel(), limit=limit
        )
