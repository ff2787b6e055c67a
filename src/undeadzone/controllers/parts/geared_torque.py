"""Computed torque for an arm behind gears: motors lead their links, and cross the gaps in time.

A link follows its path where its motor stands on the flank that carries the load, theta = q_ref - c
+ a sign(tau_ref) with tau_ref = M a_ref + h, payload included. Where that changes sign the link
needs no torque: there the motor is led across (`feedforward.flank_path`). A link that needs hardly
any floats in its gap, off its path: so a_ref has what brings it back from where it is estimated to
be once the gap is crossed, with half of the motors' bandwidth, where it is off by more than a
quarter of its gap: less may be the estimate's own noise. Gap, friction and payload are those of the
model, or what the observer makes of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import deadzone
from undeadzone.feedforward.flank_path import LEAD, Crossing, doubly_integrated, led, turned
from undeadzone.feedforward.targets import Target, along_targets
from undeadzone.interfaces import Controller, Estimate, Plan
from undeadzone.plants.robots.arm import torque
from undeadzone.plants.robots.geared import Geared
from undeadzone.plants.system import System
from undeadzone.support.arrays import Floats, scalar

KEY = "controller.crossing"
FLOATS = 0.5  # of a gap's half, by which a link that hangs in its gap is off its path
ROUNDING = 1e-9  # [N m] of a torque that has no sign


class Params(NamedTuple):
    """The arm's parameters, K_p and K_d (N), and the numbers of the way across."""

    model: Any
    k_p: Floats
    k_d: Floats
    crossing: Crossing


class State(NamedTuple):
    """What is known of the ways across.

    Attributes:
        moved: by how much motors are ahead of their links' path, and how fast that changes (2 N).
        towards: flank on which the load was last (N), 0 before there is one.
    """

    moved: Any
    towards: Any


def geared_torque(
    model: System, k_p: Floats, k_d: Floats, crossing: float, reject: bool
) -> Controller:
    """The controller for the sampled model of an arm with gears.

    Args:
        model: the model.
        k_p, k_d: gains of the motors' error (N) [1/s^2, 1/s].
        crossing: w, of the way across a gap [1/s].
        reject: whether to take into account what the observer says that the model leaves out.

    Raises:
        InputError: w cannot be.
    """
    gears, Ts = model.gears, model.Ts
    assert gears is not None
    assert Ts is not None
    N = gears.size
    numbers = doubly_integrated(scalar(KEY, crossing, above=0.0), Ts, KEY)
    ahead = round(LEAD / crossing / Ts)

    def init(p: Params) -> State:
        return State(np.zeros(2 * N), np.zeros(N))

    def step(p: Params, s: State, estimate: Estimate, target: Target) -> tuple[State, Any]:
        a, *later, swung = ca.vertsplit(target.plan, N)
        q, v = target.x_ref[N : 2 * N], target.x_ref[3 * N :]
        motor, link, spin, speed = ca.vertsplit(estimate.x, N)
        astray = q - link + (LEAD / crossing + 2 * p.k_d / p.k_p) * (v - speed)
        half = gears.number(p.model, "half")
        back = swung + p.k_p / 4 * deadzone(astray, FLOATS * half, FLOATS * half)
        towards = carrying(gears, p.model, (*later, back), s.towards)
        moved = ca.reshape(s.moved, N, 2).T
        push, following = led(p.crossing, moved, (towards * half).T)
        place, turning = q - gears.number(p.model, "centre") + moved[0, :].T, v + moved[1, :].T
        correction = p.k_p * (place - motor) + p.k_d * (turning - spin)
        links = torque(gears.arm, gears.links(p.model), q, v, a + correction)
        known = reject and estimate.w.shape[0] > 0  # what the model leaves out
        spinning = a + push.T + correction - (estimate.w[2 * N : 3 * N] if known else 0.0)
        motors = gears.number(p.model, "inertia") * spinning + gears.friction(p.model, turning)
        return State(ca.reshape(following.T, 2 * N, 1), towards), links + motors

    def along(params: Any, target: Target) -> Floats:
        path = np.hstack([target.x_ref[:, N : 2 * N], target.x_ref[:, 3 * N :]])
        a = accelerations(gears, params, target)
        later = np.minimum(np.arange(len(a)) + ahead, len(a) - 1)
        return np.hstack([a, path[later], a[later]])

    plan = Plan(4 * N, model.params, along)
    return Controller(Params(model.params, k_p, k_d, numbers), init, step, plan)


def carrying(gears: Geared, params: Any, path: Any, before: Any) -> Any:
    """The flank that carries each link on its path (N): +1 right, -1 left, the last one at rest.

    Args:
        gears: the arm.
        params: its parameters.
        path: positions, speeds and accelerations of the links (3, N each).
        before: the flank before (N).
    """
    load = torque(gears.arm, gears.links(params), *path)
    return turned(ca.sign(load) * (ca.fabs(load) > ROUNDING), before)


def accelerations(gears: Geared, params: Floats, target: Target) -> Floats:
    """The links' acceleration on the path (instants x N), their motors turning with them.

    Args:
        gears: the arm.
        params: its parameters.
        target: the reference, a row per instant.
    """
    N, p = gears.size, ca.SX(params)

    def turned_together(x: Any, u: Any) -> Any:
        q, v = x[N : 2 * N], x[3 * N :]
        held = torque(gears.arm, gears.links(p), q, v, ca.SX(N, 1)) + gears.friction(p, v)
        M = gears.arm.mass(gears.links(p), q) + ca.diag(gears.number(p, "inertia"))
        return ca.solve(M, u - held)

    return along_targets(turned_together, target)
