"""Linear-quadratic regulation about a trajectory: the gains of the Riccati equation along the reference."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate, Plan
from undeadzone.linear.matrices import Matrices
from undeadzone.linear.riccati import riccati, riccati_along, weight
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, Floats


class LQR(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="lqr",
):
    """u = u_ff - K(t) (x^ - x_ref), K(t) such that the sum of e'Q e + v'R v over the samples is least, e = x - x_ref, v = u - u_ff.

    e follows the linearisation of the sampled model along (x_ref, u_ff): Bryson and Ho (1975), Anderson and Moore (1990).
    Q, R: weights of the states and of the inputs, a number, one per entry, or a matrix. Any plant that has a feedforward; of a
    linear one K is constant. Sampled time only. stride: linearise every so many samples, straight lines between: faster for long
    runs of large arms.
    """

    Q: Array = 1.0
    R: Array = 1.0
    stride: int = 1

    def build(self, model: System) -> Controller:
        """The controller for a sampled model. Raises InputError, ShapeError; its plan raises StructureError."""
        if model.Ts is None:
            raise InputError(
                "controller.method: 'lqr' works on samples; set simulation.time = \"sampled\" (simulation.step is the sample time)"
            )
        if self.stride < 1:
            raise InputError(
                f"controller.stride: expected a number of samples, at least 1, found {self.stride}"
            )
        n, m = model.n, model.m
        params = Params(
            weight("controller.Q", self.Q, n),
            weight("controller.R", self.R, m, "inputs x inputs"),
            self.stride,
        )

        def step(p: Any, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            return s, target.u_ff - ca.reshape(target.plan, m, n) @ (estimate.x - target.x_ref)

        def along(params: Params, target: Target) -> Floats:
            return gains(model, params, target).reshape(-1, m * n, order="F")

        return Controller((), lambda p: None, step, Plan(m * n, params, along))


class Params(NamedTuple):
    """Of the plan: Q (n x n), R (m x m), stride."""

    Q: Floats
    R: Floats
    stride: int


def gains(model: System, params: Params, target: Target) -> Floats:
    """K (instants x m x n) along a trajectory, whose end is taken for a steady state. Raises StructureError where that has no gain."""
    Q, R, stride = params
    if not model.nonlinear:
        return np.broadcast_to(
            riccati(model.linear, Q, R, model.Ts).K, (len(target.u_ff), model.m, model.n)
        )
    A, B = linearised(model, target, stride)
    last = riccati(Matrices(A[-1], B[-1], model.linear.C), Q, R, model.Ts)
    return riccati_along(A, B, Q, R, last.P)


def linearised(model: System, target: Target, stride: int) -> tuple[Floats, Floats]:
    """A (instants x n x n), B (instants x n x m) of a model along a trajectory, in straight lines between every `stride`-th instant."""
    from scipy.interpolate import interp1d

    instants = np.arange(len(target.u_ff))
    chosen = np.unique(np.append(instants[::stride], instants[-1]))
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    jacobian = ca.Function(
        "jacobian", [x, u], [ca.jacobian(model.move(ca.SX(model.params), x, u), ca.vertcat(x, u))]
    )
    found = jacobian.map(chosen.size)(target.x_ref[chosen].T, target.u_ff[chosen].T).full()
    both = found.reshape(model.n, chosen.size, -1).swapaxes(0, 1)
    if stride > 1:
        both = interp1d(chosen, both, axis=0)(instants)
    return both[:, :, : model.n], both[:, :, model.n :]
