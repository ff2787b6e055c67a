"""Widths adapted by a gradient on the side of the estimate, with a robust term.

It is the way of the paper's references.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.interfaces import Observer, Reading
from undeadzone.nonlinearities.sensor import Zone, indicators
from undeadzone.observers.adaptive.output_error import (
    State,
    build_output_error_observer,
    read_adapted_widths,
)
from undeadzone.plants.system import System, fastest_pole
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_number
from undeadzone_arena.gain_defaults import injection_gain, width_hiding_speed


class RobustGradient(Options, frozen=True, kw_only=True, tag="robust_gradient"):
    """Gradient law on the side of the estimate, beside a robust tanh term.

    The robust term is that of the paper's references [16], [17].

    Attributes:
        L: gain (n x p) [1/s], in place of poles and speed.
        poles: poles of A - L C (n) [1/s], in place of L and speed.
        speed: speed of A - L C [1/s], in place of L and poles (default 8 mean poles of the plant,
            fewer beyond second order).
        gamma: adaptation gain of the widths, one or one per output [1/s] (default 3 times the
            fastest pole).
        sharpness: sharpness of the indicators (8)-(10) at the edges that C x^ meets [1/z].
        rho: how far the robust term, which enters by the inputs, moves z^ at most in steady state
            [z].
        width: |e| at which the robust term saturates [z].
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M per side, one or one per output [z] (default none).
    """

    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    gamma: Array | None = None
    sharpness: float = 20.0
    rho: float = 0.05
    width: float = 0.1
    widths0: Array = 0.0
    width_max: Array | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """Build the observer for a model, continuous or sampled."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: 'robust_gradient' compares with a dead zone, which a jump sensor "
                "has not. Use 'certified' or 'censored'"
            )
        gamma = 3 * fastest_pole(model) if self.gamma is None else self.gamma
        widths = read_adapted_widths(gamma, self.widths0, self.width_max, model, sensor)
        L = injection_gain(model, self.L, self.poles, self.speed, width_hiding_speed(model, 8.0))
        rho = require_number("observer.rho", self.rho, least=0.0)
        width = require_number("observer.width", self.width, above=0.0)
        sharpness = require_number("observer.sharpness", self.sharpness, above=0.0)
        robust = rho * steady_input(model, L) if rho else np.zeros((model.n, model.p))
        law = RobustLaw(robust, np.float64(width), np.float64(sharpness))
        return build_output_error_observer(
            model, sensor, L, widths, law, robust_term, side_of_estimate
        )


class RobustLaw(NamedTuple):
    """Numbers of the robust term and of the indicators.

    Attributes:
        robust: the robust term (n x p), per step when sampled.
        width: |e| at which it saturates [z].
        sharpness: sharpness of the indicators [1/z].
    """

    robust: Floats
    width: Any
    sharpness: Any


def robust_term(law: RobustLaw, e: Any) -> Any:
    """Return the robust term that is added to x^' beside L e (n)."""
    return law.robust @ ca.tanh(e / law.width)


def side_of_estimate(law: RobustLaw, s: State, z: Any, reading: Reading) -> tuple[Any, Any]:
    """Return the degrees to which z^ is beyond the two breakpoints (p each, 0 to 1)."""
    right, _ = indicators(z - s.right, law.sharpness)
    _, left = indicators(z + s.left, law.sharpness)
    return right, left


def steady_input(model: System, L: Floats) -> Floats:
    """Return B G(0)^-1 (n x p), G of A - L C from inputs to outputs.

    It moves each C x^ by 1 in steady state. Raises StructureError.
    """
    A, B, C = model.linear
    closed = A - L @ C - (0.0 if model.Ts is None else np.eye(model.n))
    still = -C @ np.linalg.solve(closed, B)
    if np.linalg.matrix_rank(still, 1e-9 * float(np.linalg.norm(B))) < model.p:
        raise StructureError(
            "observer.rho: inputs cannot move every output in steady state (fewer inputs than "
            "outputs, or a zero at s = 0). Set rho = 0"
        )
    return B @ np.linalg.pinv(still)
