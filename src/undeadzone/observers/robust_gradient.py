"""Widths by gradient on the side where the estimate is, beside a robust term: the way of the paper's references."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.interfaces import Observer, Reading
from undeadzone.observers.parts.gain import hiding, injection
from undeadzone.observers.parts.output_error import State, adapted, output_error
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole
from undeadzone.sensor import Zone, indicators
from undeadzone.support.arrays import Array, Floats, scalar


class RobustGradient(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="robust_gradient",
):
    """Gradient law on the side of the estimate, beside the robust tanh term of the paper's references [16], [17].

    L, poles [1/s] or speed [1/s]: of A - L C (default: a speed of 8 mean poles of the plant, fewer beyond second order). gamma [1/s]: of the
    widths, one or one per output (default: 3 times the fastest pole); sharpness [1/z]: of the indicators (8)-(10) at the edges
    that C x^ meets. rho [z]: how far the robust term, which enters by the inputs, moves z^ at most in steady state; width [z]: |e| at
    which it saturates. widths0: d^(0) (p x 2) [z]; width_max: d_M per side.
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
        """The observer for a model, continuous or sampled. Raises InputError, ShapeError, StructureError."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: 'robust_gradient' compares with a dead zone, which a jump sensor has not; use 'certified' or 'censored'"
            )
        widths = adapted(
            3 * fastest_pole(model) if self.gamma is None else self.gamma,
            self.widths0,
            self.width_max,
            model,
            sensor,
        )
        L = injection(model, self.L, self.poles, self.speed, hiding(model, 8.0))
        rho, width = (
            scalar("observer.rho", self.rho, least=0.0),
            scalar("observer.width", self.width, above=0.0),
        )
        sharpness = scalar("observer.sharpness", self.sharpness, above=0.0)
        robust = rho * steady_input(model, L) if rho else np.zeros((model.n, model.p))

        def inject(law: Law, e: Any) -> Any:
            return law.robust @ ca.tanh(e / law.width)

        def where(law: Law, s: State, z: Any, reading: Reading) -> tuple[Any, Any]:
            return indicators(z - s.right, law.sharpness)[0], indicators(z + s.left, law.sharpness)[
                1
            ]

        return output_error(
            model,
            sensor,
            L,
            widths,
            Law(robust, np.float64(width), np.float64(sharpness)),
            inject,
            where,
        )


class Law(NamedTuple):
    """The robust term (n x p), per step when sampled; |e| at which it saturates; sharpness of the indicators."""

    robust: Floats
    width: Any
    sharpness: Any


def steady_input(model: System, L: Floats) -> Floats:
    """B G(0)^-1 (n x p), G of A - L C from inputs to outputs: what moves each C x^ by 1 in steady state. Raises StructureError."""
    A, B, C = model.linear
    closed = A - L @ C - (0.0 if model.Ts is None else np.eye(model.n))
    still = -C @ np.linalg.solve(closed, B)
    if np.linalg.matrix_rank(still, 1e-9 * float(np.linalg.norm(B))) < model.p:
        raise StructureError(
            "observer.rho: inputs cannot move every output in steady state (fewer inputs than outputs, or a zero at s = 0); set rho = 0"
        )
    return B @ np.linalg.pinv(still)
