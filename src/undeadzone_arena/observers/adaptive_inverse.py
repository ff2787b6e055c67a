"""Adaptive dead-zone inverse: an observer with y / m + chi_bar d^ as its measurement.

Its widths learn from its error.
"""

from __future__ import annotations

from typing import Any, Literal

import casadi as ca
import numpy as np

from undeadzone.interfaces import Observer
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.observers.adaptive.adaptation_laws import read_initial_widths
from undeadzone.observers.filtering.motion_detection import add_motion_detection
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array
from undeadzone_arena.gain_defaults import injection_gain, rate_or_default, width_hiding_speed
from undeadzone_arena.observers.parts.adaptive_laws import gradient_law, least_squares_law
from undeadzone_arena.observers.parts.learned_residual import (
    WeightedFunctions,
    build_learning_observer,
)


class AdaptiveInverse(Options, frozen=True, kw_only=True, tag="adaptive_inverse"):
    """Adaptive deadzone inverse of Tao and Kokotovic (1996), here as an observer.

    Adaptive Control of Systems with Actuator and Sensor Nonlinearities.

    References:
        G. Tao, P. V. Kokotovic (1994), doi:10.1109/9.273339

    Attributes:
        L: gain (n x p) [1/s], in place of poles and speed.
        poles: poles of A - L C (n) [1/s], in place of L and speed.
        speed: speed of A - L C [1/s], in place of L and poles (default 30 mean poles of the plant,
            fewer beyond second order).
        law: normalised gradient or recursive least squares.
        gain: gain of the gradient, or the initial spread of least squares [1/s] (default 300 times
            the fastest pole).
        forgetting: rate at which least squares forget [1/s].
        silent: "hold" corrects and learns on an active side only ("zero" is the literal inverse,
            which takes a censored sample for z = 0).
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M per side, one or one per output [z], which projection keeps (default none).
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
        """Build the observer for a model, continuous or sampled."""
        p = model.p
        widths, limit = read_initial_widths(self.widths0, self.width_max, p)
        L = injection_gain(model, self.L, self.poles, self.speed, width_hiding_speed(model, 30.0))
        gain = rate_or_default(model, "observer.gain", self.gain, 300.0)
        if self.law == "gradient":
            law = gradient_law(model, gain, 0.0, 2)
        else:
            law = least_squares_law(model, gain, self.forgetting, 2)
        compensator = WeightedFunctions(None, side_indicators, 2, self.silent == "hold", np.ones(p))
        observer = build_learning_observer(
            model, sensor, L, compensator, law, filtered=True, W0=widths.ravel(), limit=limit
        )
        return add_motion_detection(observer, model, sensor)


def side_indicators(params: Any, y: Any, side: Any, z: Any) -> Any:
    """Return chi_bar of (12): 1 on the right, -1 on the left, so that W = `[d_r; d_l]` (2)."""
    return ca.vertcat(side > 0, -(side < 0))
