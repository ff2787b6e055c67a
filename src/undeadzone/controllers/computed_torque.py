"""Computed torque: a rigid arm becomes as many double integrators as joints.

Behind gears motors lead their links, and cross the gaps in time. A link follows its path if its
motor stands on the flank that carries the load, theta = q_ref - c + a sign(tau_ref) with tau_ref =
M a_ref + h, payload included. When that changes sign the link needs no torque: then the motor is
led across (`feedforward.flank_path`). A link that needs hardly any torque floats in its gap, off
its path. So a_ref contains a term that brings it back from its estimated position once the gap is
crossed, with half of the motors' bandwidth, if it is off by more than a quarter of its gap (less
may be the estimate's own noise). Gap, friction and payload are those of the model, or the
observer's estimates of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, StepError
from undeadzone.feedforward.flank_path import LEAD, choose_flank, doubly_integrated, step_filters
from undeadzone.feedforward.targets import Target, along_targets
from undeadzone.interfaces import Controller, Estimate, Plan
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.plants.robots.arm import Arm, forward_dynamics, inverse_dynamics
from undeadzone.plants.robots.geared import Geared
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Array, Floats, require_number, require_positive

KEY = "controller.crossing"
FLOATS = 0.5  # of a gap's half, by which a link that hangs in its gap is off its path
ROUNDING = 1e-9  # [N m] of a torque that has no sign


class ComputedTorque(Options, frozen=True, kw_only=True, tag="computed_torque"):
    """Computed torque for a rigid arm: Craig (1986), and Slotine and Li (1991).

    u = M(q^) (a_ref + K_d (v_ref - v^) + K_p (q_ref - q^)) + h(q^, v^) + friction(v^). With the
    model right and x^ = x the error obeys e'' + K_d e' + K_p e = 0. Either a bandwidth w and a
    damping z, K_p = w^2 and K_d = 2 z w, or k_p and k_d are given.

    Example:
        >>> uz.ComputedTorque(bandwidth=10.0).bandwidth
        10.0

    See Also:
        StateFeedback, LQR

    Attributes:
        bandwidth: w, one or one per joint [rad/s].
        damping: z, one or one per joint.
        k_p: K_p, one or one per joint [1/s^2].
        k_d: K_d, one or one per joint [1/s].
        reject: if the observer estimates what its model leaves out, x' = f(x, u) + w^, take it into
            account.
        crossing: w, of an arm with gears: their gaps are crossed with both poles at -w, when the
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
        """Return the controller for the model of a rigid arm, continuous or sampled.

        Raises InputError.
        """
        arm = model.arm
        if arm is None or arm.joint_count != model.m:
            raise InputError(
                "controller.method: 'computed_torque' needs an arm whose every joint has its "
                "motor. Use 'state_feedback' or 'lqr'"
            )
        N = arm.joint_count
        k_p, k_d = self._joint_gains(N)
        if model.Ts is not None:
            _require_fine_step(k_p, k_d, model.Ts)
        if model.gears is not None:
            return build_gear_controller(model, k_p, k_d, self.crossing, self.reject)

        def step(p: Params, s: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
            """Return the state unchanged, and the torques of the joints (N) [N m]."""
            q = estimate.x[:N]
            v = estimate.x[N:]
            drift, push = self._model_residual(estimate, N)
            speed_error = target.x_ref[N:] - v - drift
            error = target.x_ref[:N] - q
            acceleration = target.plan + p.k_d * speed_error + p.k_p * error
            return s, inverse_dynamics(arm, p.model, q, v, acceleration - push)

        plan = Plan(N, model.params, lambda params, target: path_accelerations(arm, params, target))
        return Controller(Params(model.params, k_p, k_d), lambda p: None, step, plan)

    def _model_residual(self, estimate: Estimate, N: int) -> tuple[Any, Any]:
        """Return the estimated w^ in q' and q'' (N each), or 0 if not rejected."""
        if self.reject and estimate.w.shape[0] > 0:
            return estimate.w[:N], estimate.w[N:]
        return 0.0, 0.0

    def _joint_gains(self, N: int) -> tuple[Floats, Floats]:
        """Return (K_p, K_d) (N each) [1/s^2, 1/s]. Raises InputError, ShapeError."""
        chosen = [name for name in ("bandwidth", "k_p", "k_d") if getattr(self, name) is not None]

        def per_joint(name: str) -> Floats:
            """Return a positive option per joint (N)."""
            return require_positive(f"controller.{name}", getattr(self, name), N, "one per joint")

        if chosen == ["bandwidth"]:
            w = per_joint("bandwidth")
            z = per_joint("damping")
            return w**2, 2 * z * w
        if chosen == ["k_p", "k_d"]:
            return per_joint("k_p"), per_joint("k_d")
        raise InputError(
            "controller: computed_torque needs either bandwidth (and damping), or k_p and k_d, "
            f"found {' and '.join(chosen) or 'none'}"
        )


class Params(NamedTuple):
    """Parameters of the arm, K_p and K_d (N). Behind gears also those of the gap crossing."""

    model: Any
    k_p: Floats
    k_d: Floats
    crossing: Any = None


def path_accelerations(arm: Arm, params: Floats, target: Target) -> Floats:
    """Return the joints' acceleration on the path (instants x N) [rad/s^2].

    It is what u_ff does at x_ref, so that on the path u = u_ff.

    Args:
        arm: the arm.
        params: its parameters.
        target: the reference, a row per instant.
    """
    N = arm.joint_count
    return along_targets(
        lambda x, u: forward_dynamics(arm, ca.SX(params), x[:N], x[N:], u),
        target,
    )


def _require_fine_step(k_p: Floats, k_d: Floats, Ts: float) -> None:
    """Raise StepError if the double integrators are unstable (Jury's conditions).

    Their input is held over Ts.
    """
    unstable = np.flatnonzero((k_d * Ts >= 2) | (k_p * Ts >= 2 * k_d)).tolist()
    if unstable:
        i = unstable[0]
        longest = min(2 / k_d[i], 2 * k_d[i] / k_p[i])
        raise StepError(
            f"simulation.step: {Ts:g} s is too coarse for the controller: joint {i} with K_p = "
            f"{k_p[i]:.4g}, K_d = {k_d[i]:.4g} is stable only for steps below {longest:.2g} s. "
            "Use a smaller step or a lower bandwidth"
        )


# --- Behind gears


class State(NamedTuple):
    """State of the gap crossing.

    Attributes:
        moved: by how much motors are ahead of their links' path, and how fast that changes (2 N).
        towards: flank on which the load was last (N), 0 before there is one.
    """

    moved: Any
    towards: Any


def build_gear_controller(
    model: System, k_p: Floats, k_d: Floats, crossing: float, reject: bool
) -> Controller:
    """Return the controller for the sampled model of an arm with gears.

    Args:
        model: the model.
        k_p, k_d: gains of the motors' error (N) [1/s^2, 1/s].
        crossing: w, of the way across a gap [1/s].
        reject: whether to take into account the observer's estimate of the effects that the model
            leaves out.

    Raises:
        InputError: w cannot be.
    """
    gears = model.gears
    Ts = model.Ts
    assert gears is not None
    assert Ts is not None
    N = gears.joint_count
    numbers = doubly_integrated(require_number(KEY, crossing, above=0.0), Ts, KEY)
    ahead = round(LEAD / crossing / Ts)

    def init(p: Params) -> State:
        """Return the state at t = 0."""
        return State(np.zeros(2 * N), np.zeros(N))

    def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
        """Return the next state, and the torques of the motors (N) [N m]."""
        a, *later, swung = ca.vertsplit(target.plan, N)
        q = target.x_ref[N : 2 * N]
        v = target.x_ref[3 * N :]
        motor, link, spin, speed = ca.vertsplit(estimate.x, N)
        astray = q - link + (LEAD / crossing + 2 * p.k_d / p.k_p) * (v - speed)
        half = gears.gear_number(p.model, "half")
        back = swung + p.k_p / 4 * deadzone(astray, FLOATS * half, FLOATS * half)
        towards = carrying_flank(gears, p.model, (*later, back), s.towards)
        moved = ca.reshape(s.moved, N, 2).T
        push, following = step_filters(p.crossing, moved, (towards * half).T)
        place = q - gears.gear_number(p.model, "centre") + moved[0, :].T
        turning = v + moved[1, :].T
        correction = p.k_p * (place - motor) + p.k_d * (turning - spin)
        links = gears.link_torque(p.model, q, v, a + correction)
        known = reject and estimate.w.shape[0] > 0  # effects that the model leaves out
        spinning = a + push.T + correction - (estimate.w[2 * N : 3 * N] if known else 0.0)
        motors = gears.gear_number(p.model, "inertia") * spinning + gears.motor_friction_torque(
            p.model, turning
        )
        return State(ca.reshape(following.T, 2 * N, 1), towards), links + motors

    def along(params: Any, target: Target) -> Floats:
        """Return accelerations now, and the links' path ahead (instants x 4N)."""
        path = np.hstack([target.x_ref[:, N : 2 * N], target.x_ref[:, 3 * N :]])
        a = link_accelerations(gears, params, target)
        later = np.minimum(np.arange(len(a)) + ahead, len(a) - 1)
        return np.hstack([a, path[later], a[later]])

    plan = Plan(4 * N, model.params, along)
    return Controller(Params(model.params, k_p, k_d, numbers), init, step, plan)


def carrying_flank(gears: Geared, params: Any, path: Any, before: Any) -> Any:
    """Return the flank that carries each link on its path (N): +1 right, -1 left.

    At rest the last flank stays.

    Args:
        gears: the arm.
        params: its parameters.
        path: positions, speeds and accelerations of the links (3, N each).
        before: the flank before (N).
    """
    load = gears.link_torque(params, *path)
    return choose_flank(ca.sign(load) * (ca.fabs(load) > ROUNDING), before)


def link_accelerations(gears: Geared, params: Floats, target: Target) -> Floats:
    """Return the links' acceleration on the path (instants x N) [rad/s^2].

    The motors turn along.

    Args:
        gears: the arm.
        params: its parameters.
        target: the reference, a row per instant.
    """
    N = gears.joint_count
    p = ca.SX(params)

    def turned_together(x: Any, u: Any) -> Any:
        """Return the acceleration of links and motors that turn together (N) [rad/s^2]."""
        q = x[N : 2 * N]
        v = x[3 * N :]
        bias_torque = gears.link_torque(p, q, v, ca.SX(N, 1)) + gears.motor_friction_torque(p, v)
        M = gears.arm.mass(gears.link_params(p), q) + ca.diag(gears.gear_number(p, "inertia"))
        return ca.solve(M, u - bias_torque)

    return along_targets(turned_together, target)
