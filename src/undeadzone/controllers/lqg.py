"""Linear-quadratic feedback on the estimate, with an optional integral of the control error."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.controllers.parts import select_tracked_output
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import require_weight, solve_riccati
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats


class LQG(Options, frozen=True, kw_only=True, tag="lqg"):
    """Feedback u = u_ff - K (x^ - x_ref) - K_i int (z^ - r), of least quadratic cost.

    With a filter as observer this is the linear-quadratic-Gaussian servo (Anderson and Moore,
    Optimal Control: Linear Quadratic Methods, 1990): the filter is built for the noise, these
    gains for the cost, each alone. The gains are constant, for the model or its linearisation.

    Example:
        >>> uz.LQG(Q=[1.0, 0.0], R=[0.1]).R
        [0.1]

    See Also:
        LQR, StateFeedback

    Attributes:
        Q: weight of the states, a number, one per state, or a matrix.
        R: weight of the inputs, a number, one per input, or a matrix.
        integral: weight of the integral of z^ - r, a number, one per output, or a matrix (default:
            no integral). It removes the error that a constant disturbance leaves.
    """

    Q: Array = 1.0
    R: Array = 1.0
    integral: Array | None = None

    def build(self, model: System) -> Controller:
        """Return the controller for a model, continuous or sampled.

        Raises InputError, StructureError.
        """
        Q = require_weight("controller.Q", self.Q, model.n)
        R = require_weight("controller.R", self.R, model.m, "inputs x inputs")
        if self.integral is None:
            K = solve_riccati(model.linear, Q, R, model.Ts).K
            return Controller(Params(K), lambda p: None, _feedback_law, K=K)
        params = self._servo_gains(model, Q, R)

        def init(p: Params) -> State:
            """Return the state at t = 0: zero integrals."""
            return State(np.zeros(model.p))

        def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
            """Return the integrals' derivative, or next value if sampled, and u (m)."""
            error = select_tracked_output("lqg", estimate, target) - target.r
            _, u = _feedback_law(p, None, estimate, target)
            return State(model.keep * s.integral + p.grown * error), u - p.K_i @ s.integral

        return Controller(params, init, step, K=params.K)

    def _servo_gains(self, model: System, Q: Floats, R: Floats) -> Params:
        """Return the gains of states and integrals together.

        Raises InputError, StructureError.
        """
        if model.p > model.m:
            raise InputError(
                "controller.integral: needs as many inputs as outputs at least, the plant has "
                f"{model.m} and {model.p}"
            )
        n = model.n
        p = model.p
        assert self.integral is not None
        of_integrals = require_weight("controller.integral", self.integral, p, "outputs x outputs")
        A, B, C = model.linear
        grown = model.per_step
        both = Matrices(
            np.block([[A, np.zeros((n, p))], [grown * C, model.keep * np.eye(p)]]),
            np.vstack([B, np.zeros((p, model.m))]),
            np.hstack([C, np.zeros((p, p))]),
        )
        weights = np.block([[Q, np.zeros((n, p))], [np.zeros((p, n)), of_integrals]])
        K = solve_riccati(both, weights, R, model.Ts).K
        return Params(K[:, :n], K[:, n:], np.float64(grown))


class Params(NamedTuple):
    """Gains of the states (m x n) and of the integrals (m x p).

    The third number is the integrals' growth per step.

    Without an integral the first alone.
    """

    K: Floats
    K_i: Any = None
    grown: Any = None


class State(NamedTuple):
    """Integral of z^ - r (p) [z s]."""

    integral: Any


def _feedback_law(p: Any, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
    """Return the state unchanged, and u (m) by the law without an integral."""
    return s, target.u_ff - p.K @ (estimate.x - target.x_ref)
