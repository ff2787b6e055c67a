"""State feedback on the estimate plus feedforward, the working form of (29)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linear.poles import state_gain
from undeadzone.linear.riccati import feedback, lyapunov, weight
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, Floats, array, matrix, scalar


class Robust(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The robust term of the paper's references [16], [17]: -gain * tanh(B'P (x^ - x_ref) / width), against matched disturbances up to gain."""

    gain: float
    width: float = 0.1


class StateFeedback(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="state_feedback",
):
    """u = u_ff - K (x^ - x_ref) with exactly one of: K (m x n); poles of A - B K [1/s]; alpha and Q of (34).

    With alpha, K = alpha B'P where A'P + PA - 2 alpha P B B' P = -Q: (34) with A in place of A - L C. Sampled models
    get the sampled counterpart of the same choice. robust: an optional tanh term. reject: where the observer
    estimates what its model leaves out, x' = f(x, u) + w^, move x_ref and u_ff so that z would follow r if w^ stayed as it is (the first m
    outputs where there are more; Muske and Badgwell 2002).
    """

    K: Array | None = None
    poles: Array | None = None
    alpha: float | None = None
    Q: Array = 1.0
    robust: Robust | None = None
    reject: bool = True

    def build(self, model: System) -> Controller:
        """The controller for a model, continuous or sampled. Raises InputError, StructureError."""
        given = [name for name in ("K", "poles", "alpha") if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(
                f"controller: state_feedback needs exactly one of K, poles, alpha; found {' and '.join(given) or 'none'}"
            )
        Q = weight("controller.Q", self.Q, model.n)
        if self.K is not None:
            K = np.atleast_2d(array("controller.K", self.K))
            K = matrix("controller.K", K, model.m, model.n, "inputs x states")
        elif self.poles is not None:
            K = state_gain(model.linear, self.poles, model.Ts)
        else:
            K = feedback(
                model.linear, scalar("controller.alpha", self.alpha, above=0.0), Q, model.Ts
            )
        counter = np.hstack([K, np.eye(model.m)]) @ rest(model)
        params = Params(K, np.zeros((model.m, model.n)), np.float64(0.0), np.float64(1.0), counter)
        if self.robust is not None:
            P = lyapunov(model.linear, K, Q, model.Ts)
            rho = scalar("controller.robust.gain", self.robust.gain, least=0.0)
            params = Params(
                K,
                model.linear.B.T @ P,
                np.float64(rho),
                np.float64(scalar("controller.robust.width", self.robust.width, above=0.0)),
                counter,
            )
        robust = self.robust is not None

        def step(p: Params, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            u = (target.u_ff + p.K @ target.x_ref) - p.K @ estimate.x
            if self.reject and estimate.w.shape[0]:
                u = u + p.counter @ estimate.w
            return s, u - p.rho * ca.tanh(
                p.BtP @ (estimate.x - target.x_ref) / p.width
            ) if robust else u

        return Controller(params, lambda p: None, step, K=K)


def rest(model: System) -> Floats:
    """[x; u] per unit of a constant w, for which x' = A x + B u + w and the first m outputs are at rest at 0 ((n + m) x n)."""
    A, B, C = model.linear if model.flow is None else model.flow
    C = C[: model.m]
    return -np.linalg.pinv(np.block([[A, B], [C, np.zeros((len(C), model.m))]]), rcond=1e-10)[
        :, : model.n
    ]


class Params(NamedTuple):
    """K (m x n); B'P (m x n), rho, width of the robust term; counter (m x n): what of u a w^ asks for."""

    K: Floats
    BtP: Floats
    rho: Any
    width: Any
    counter: Floats
