"""Computed torque makes a rigid arm as many double integrators as it has joints."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.catalogue import Options
from undeadzone.controllers.parts.geared_torque import geared_torque
from undeadzone.errors import InputError, StepError
from undeadzone.feedforward.targets import Target, along_targets
from undeadzone.interfaces import Controller, Estimate, Plan
from undeadzone.plants.robots.arm import Arm, acceleration, torque
from undeadzone.plants.system import System
from undeadzone.support.arrays import Array, Floats, positive


class ComputedTorque(Options, frozen=True, kw_only=True, tag="computed_torque"):
    """Computed torque for a rigid arm: Craig; Slotine and Li (1991).

    u = M(q^) (a_ref + K_d (v_ref - v^) + K_p (q_ref - q^)) + h(q^, v^) + friction(v^). With the
    model right and x^ = x the error obeys e'' + K_d e' + K_p e = 0. Either a bandwidth w and a
    damping z, K_p = w^2 and K_d = 2 z w; or k_p and k_d.

    Attributes:
        bandwidth: w, one or one per joint [rad/s].
        damping: z, one or one per joint.
        k_p: K_p, one or one per joint [1/s^2].
        k_d: K_d, one or one per joint [1/s].
        reject: where the observer estimates what its model leaves out, x' = f(x, u) + w^, take it
            into account.
        crossing: w, of an arm with gears: their gaps are crossed with both poles at -w, where the
            torque that a link needs changes sign [1/s].
    """

    gears = True  # it knows them

    bandwidth: Array | None = None
    damping: Array = 1.0
    k_p: Array | None = None
    k_d: Array | None = None
    reject: bool = True
    crossing: float = 30.0

    def build(self, model: System) -> Controller:
        """The controller for the model of a rigid arm, continuous or sampled."""
        arm = model.arm
        if arm is None or arm.size != model.m:
            raise InputError(
                "controller.method: 'computed_torque' needs an arm whose every joint has its "
                "motor; use 'state_feedback' or 'lqr'"
            )
        N = arm.size
        k_p, k_d = self._gains(N)
        if model.Ts is not None:
            _require_fine_step(k_p, k_d, model.Ts)
        if model.gears is not None:
            return geared_torque(model, k_p, k_d, self.crossing, self.reject)

        def step(p: Params, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            q, v = estimate.x[:N], estimate.x[N:]
            drift, push = self._left_out(estimate, N)
            speed_error = target.x_ref[N:] - v - drift
            error = target.x_ref[:N] - q
            wanted = target.plan + p.k_d * speed_error + p.k_p * error
            return s, torque(arm, p.model, q, v, wanted - push)

        plan = Plan(N, model.params, lambda params, target: accelerations(arm, params, target))
        return Controller(Params(model.params, k_p, k_d), lambda p: None, step, plan)

    def _left_out(self, estimate: Estimate, N: int) -> tuple[Any, Any]:
        """What the model leaves out of q' and q'' (N each), 0 where that is not to be rejected."""
        if self.reject and estimate.w.shape[0] > 0:
            return estimate.w[:N], estimate.w[N:]
        return 0.0, 0.0

    def _gains(self, N: int) -> tuple[Floats, Floats]:
        """(K_p, K_d) (N each). Raises InputError, ShapeError."""
        chosen = [name for name in ("bandwidth", "k_p", "k_d") if getattr(self, name) is not None]

        def per_joint(name: str) -> Floats:
            return positive(f"controller.{name}", getattr(self, name), N, "one per joint")

        if chosen == ["bandwidth"]:
            w, z = per_joint("bandwidth"), per_joint("damping")
            return w**2, 2 * z * w
        if chosen == ["k_p", "k_d"]:
            return per_joint("k_p"), per_joint("k_d")
        raise InputError(
            "controller: computed_torque needs either bandwidth (and damping), or k_p and k_d; "
            f"found {' and '.join(chosen) or 'none'}"
        )


class Params(NamedTuple):
    """The arm's parameters, K_p and K_d (N)."""

    model: Any
    k_p: Floats
    k_d: Floats


def accelerations(arm: Arm, params: Floats, target: Target) -> Floats:
    """The joints' acceleration on the path (instants x N).

    It is what u_ff does at x_ref, so that on the path u = u_ff.

    Args:
        arm: the arm.
        params: its parameters.
        target: the reference, a row per instant.
    """
    N = arm.size
    return along_targets(
        lambda x, u: acceleration(arm, ca.SX(params), x[:N], x[N:], u),
        target,
    )


def _require_fine_step(k_p: Floats, k_d: Floats, Ts: float) -> None:
    """Raise StepError where the double integrators are not stable (Jury's conditions).

    Their input is held over Ts.
    """
    unstable = np.flatnonzero((k_d * Ts >= 2) | (k_p * Ts >= 2 * k_d)).tolist()
    if unstable:
        i = unstable[0]
        longest = min(2 / k_d[i], 2 * k_d[i] / k_p[i])
        raise StepError(
            f"simulation.step: {Ts:g} s is too coarse for the controller: joint {i} with K_p = "
            f"{k_p[i]:.4g}, K_d = {k_d[i]:.4g} is stable only for steps below {longest:.2g} s; "
            "use a smaller step or a lower bandwidth"
        )
