"""Linear-quadratic regulation about a trajectory, with gains of a Riccati equation."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate, Plan
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import require_weight, riccati_along, solve_riccati
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats


class LQR(Options, frozen=True, kw_only=True, tag="lqr"):
    """Feedback u = u_ff - K(t) (x^ - x_ref), K(t) the linear-quadratic gain.

    Sampled time only.

    The sum of e'Q e + v'R v over the samples is least, e = x - x_ref, v = u - u_ff. e follows the
    linearisation of the sampled model along (x_ref, u_ff): Bryson and Ho (1975), Anderson and Moore
    (1990). It suits any plant that has a feedforward. For a linear plant K is constant.

    Example:
        >>> uz.LQR(Q=[1.0, 0.0], R=[0.1]).Q
        [1.0, 0.0]

    See Also:
        LQG, StateFeedback

    Attributes:
        Q: weight of the states, a number, one per state, or a matrix.
        R: weight of the inputs, a number, one per input, or a matrix.
        stride: linearise every so many samples, straight lines between: faster for long runs of
            large arms.
    """

    Q: Array = 1.0
    R: Array = 1.0
    stride: int = 1

    def build(self, model: System) -> Controller:
        """Return the controller for a sampled model. Raises InputError."""
        if model.Ts is None:
            raise InputError(
                "controller.method: 'lqr' works on samples. Set simulation.time = \"sampled\" "
                "(simulation.step is the sample time)"
            )
        if self.stride < 1:
            raise InputError(
                f"controller.stride: expected a number of samples, at least 1, found {self.stride}"
            )
        n = model.n
        m = model.m
        Q = require_weight("controller.Q", self.Q, n)
        R = require_weight("controller.R", self.R, m, "inputs x inputs")

        def step(p: Any, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            """Return the state unchanged, and u (m) by the planned gain."""
            K = ca.reshape(target.plan, m, n)
            return s, target.u_ff - K @ (estimate.x - target.x_ref)

        def along(params: Params, target: Target) -> Floats:
            """Return the gains along the reference (instants x m n)."""
            return trajectory_gains(model, params, target).reshape(-1, m * n, order="F")

        plan = Plan(m * n, Params(Q, R, self.stride), along)
        return Controller((), lambda p: None, step, plan)


class Params(NamedTuple):
    """Parameters of the plan: Q (n x n), R (m x m), stride."""

    Q: Floats
    R: Floats
    stride: int


def trajectory_gains(model: System, params: Params, target: Target) -> Floats:
    """Return K along a trajectory (instants x m x n). The end counts as a steady state.

    Args:
        model: the sampled model.
        params: weights and stride.
        target: the trajectory, a row per instant.

    Raises:
        StructureError: if the end has no gain.
    """
    Q, R, stride = params
    if not model.nonlinear:
        K = solve_riccati(model.linear, Q, R, model.Ts).K
        return np.broadcast_to(K, (len(target.u_ff), model.m, model.n))
    A, B = linearise_trajectory(model, target, stride)
    last = solve_riccati(Matrices(A[-1], B[-1], model.linear.C), Q, R, model.Ts)
    return riccati_along(A, B, Q, R, last.P)


def linearise_trajectory(model: System, target: Target, stride: int) -> tuple[Floats, Floats]:
    """Return A (instants x n x n), B (instants x n x m) of a model along a trajectory.

    Between every `stride`-th instant they are straight lines.

    Args:
        model: the sampled model.
        target: the trajectory, a row per instant.
        stride: instants from one linearisation to the next.
    """
    from scipy.interpolate import interp1d

    n = model.n
    instants = np.arange(len(target.u_ff))
    chosen = np.unique(np.append(instants[::stride], instants[-1]))
    x = ca.SX.sym("x", n)
    u = ca.SX.sym("u", model.m)
    after = model.move(ca.SX(model.params), x, u)
    jacobian = ca.Function("jacobian", [x, u], [ca.jacobian(after, ca.vertcat(x, u))])
    along = jacobian.map(chosen.size)(target.x_ref[chosen].T, target.u_ff[chosen].T).full()
    AB = along.reshape(n, chosen.size, -1).swapaxes(0, 1)
    if stride > 1:
        AB = interp1d(chosen, AB, axis=0)(instants)
    return AB[:, :, :n], AB[:, :, n:]
