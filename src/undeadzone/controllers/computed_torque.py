"""Computed torque: the model's own dynamics make of a rigid arm as many double integrators as it has joints."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError, StepError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate, Plan
from undeadzone.plants.robots.arm import Arm, acceleration, torque
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, Floats, positive


class ComputedTorque(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="computed_torque",
):
    """u = M(q^) (a_ref + K_d (v_ref - v^) + K_p (q_ref - q^)) + h(q^, v^) + friction(v^) for a rigid arm: Craig; Slotine and Li (1991).

    With the model right and x^ = x the error obeys e'' + K_d e' + K_p e = 0. Either bandwidth w [rad/s] and damping z, K_p = w^2 and
    K_d = 2 z w; or k_p [1/s^2] and k_d [1/s]; each one or one per joint. reject: where the observer estimates what its model leaves
    out, x' = f(x, u) + w^, take it into account.
    """

    bandwidth: Array | None = None
    damping: Array = 1.0
    k_p: Array | None = None
    k_d: Array | None = None
    reject: bool = True

    def build(self, model: System) -> Controller:
        """The controller for the model of a rigid arm, continuous or sampled. Raises InputError, ShapeError, StepError."""
        if (arm := model.arm) is None or arm.size != model.m:
            raise InputError(
                "controller.method: 'computed_torque' needs an arm whose every joint has its motor; use 'state_feedback' or 'lqr'"
            )
        k_p, k_d = self._gains(arm.size)
        if model.Ts is not None:
            _require_fine_step(k_p, k_d, model.Ts)
        N = arm.size

        def step(p: Params, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            q, v = estimate.x[:N], estimate.x[N:]
            known = self.reject and estimate.w.shape[0] > 0
            drift, push = (estimate.w[:N], estimate.w[N:]) if known else (0.0, 0.0)
            wanted = (
                target.plan
                + p.k_d * (target.x_ref[N:] - v - drift)
                + p.k_p * (target.x_ref[:N] - q)
            )
            return s, torque(arm, p.model, q, v, wanted - push)

        plan = Plan(N, model.params, lambda params, target: accelerations(arm, params, target))
        return Controller(Params(model.params, k_p, k_d), lambda p: None, step, plan)

    def _gains(self, N: int) -> tuple[Floats, Floats]:
        given = [name for name in ("bandwidth", "k_p", "k_d") if getattr(self, name) is not None]
        if given == ["bandwidth"]:
            w, z = (
                positive(f"controller.{name}", getattr(self, name), N, "one per joint")
                for name in ("bandwidth", "damping")
            )
            return w**2, 2 * z * w
        if given == ["k_p", "k_d"]:
            k_p, k_d = (
                positive(f"controller.{name}", getattr(self, name), N, "one per joint")
                for name in given
            )
            return k_p, k_d
        raise InputError(
            f"controller: computed_torque needs either bandwidth (and damping), or k_p and k_d; found {' and '.join(given) or 'none'}"
        )


class Params(NamedTuple):
    """The arm's parameters, K_p and K_d (N)."""

    model: Any
    k_p: Floats
    k_d: Floats


def accelerations(arm: Arm, params: Floats, target: Target) -> Floats:
    """The joints' acceleration on the path (instants x N): what u_ff does at x_ref, so that on the path u = u_ff."""
    N = arm.size
    x, u = ca.SX.sym("x", 2 * N), ca.SX.sym("u", N)
    found = ca.Function(
        "accelerations", [x, u], [acceleration(arm, ca.SX(params), x[:N], x[N:], u)], {"cse": True}
    )
    return np.asarray(found.map(len(target.u_ff))(target.x_ref.T, target.u_ff.T).full().T)


def _require_fine_step(k_p: Floats, k_d: Floats, Ts: float) -> None:
    """Raise StepError where the double integrators, their input held over Ts, are not stable (Jury's conditions)."""
    if unstable := np.flatnonzero((k_d * Ts >= 2) | (k_p * Ts >= 2 * k_d)).tolist():
        i = unstable[0]
        raise StepError(
            f"simulation.step: {Ts:g} s is too coarse for the controller: joint {i} with K_p = {k_p[i]:.4g}, K_d = {k_d[i]:.4g} is stable only for steps "
            f"below {min(2 / k_d[i], 2 * k_d[i] / k_p[i]):.2g} s; use a smaller step or a lower bandwidth"
        )
