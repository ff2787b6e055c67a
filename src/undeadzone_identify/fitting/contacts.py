"""Motion of arms with gears over a sample, integrated from contact to contact.

A torque of contact begins at once. Steps of integration over that moment are off by an amount that
jumps as the moment passes from step to step, and with it a likelihood. Here a step ends where a
contact changes, so that the motion is smooth in the numbers of the gears.
"""

from __future__ import annotations

import math
from typing import Any, Final

import casadi as ca
import numpy as np

from undeadzone.numerics.clip import clip
from undeadzone.numerics.runge_kutta import hermite, hermite_slope, rk4_change
from undeadzone.observers.contact import RESOLVED
from undeadzone.plants.robots.geared import Geared
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats

ROUNDS: Final = 4  # Newton steps to the moment of a change
STILL: Final = 1e-12  # slope of a path [rad] that has no such moment


def follow_contacts(model: System) -> System:
    """Return a sampled arm with gears whose steps end where a contact changes, one of them a step.

    Another plant stays as it is. Steps are as long as the frequency of contact lets them be.

    Args:
        model: the sampled plant.
    """
    gears = model.gears
    if gears is None:
        return model
    assert model.Ts is not None
    fastest = float(np.max(np.asarray(gears.gear_number(gears.values, "contact"))))
    substeps = math.ceil(model.Ts * fastest / RESOLVED)
    h = model.Ts / substeps

    def change(params: Any, x: Any, u: Any) -> Any:
        """Return the change of x in a sample (n)."""
        total = 0.0
        for _ in range(substeps):
            total += _change_in_step(model, params, x + total, u, h)
        return total

    return model._replace(change=change, move=lambda params, x, u: x + change(params, x, u))


def _change_in_step(model: System, params: Any, x: Any, u: Any, h: float) -> Any:
    """Return the change of x in a step (n)."""
    gears: Any = model.gears
    rate: Any = model.rate
    half = gears.gear_number(params, "half")
    start = gears.gear_angle(params, x)
    contact = ca.sign(start) * (ca.fabs(start) > half)

    def advance(begin: Any, mode: Any, time: Any) -> Any:
        """Return the change of x in a time in which the contacts stay."""
        return rk4_change(lambda state, _: rate(params, state, u, mode), begin, time)

    end = x + advance(x, contact, h)
    ahead = gears.gear_angle(params, end)
    entered = (contact == 0) * ca.sign(ahead)  # flanks that a joint in its gap moves towards
    over = (entered + contact) * ahead - half
    path = start, _closing_speed(gears, x), ahead, _closing_speed(gears, end), h
    moment = _find_moment(path, (entered + contact) * half)
    moment = ca.if_else((contact == 0) == (over > 0), moment, 1.0)
    first = ca.mmin(moment)
    after = ca.if_else(ca.logic_and(moment < 1.0, moment <= first), entered, contact)
    before = advance(x, contact, h * first)
    return before + advance(x + before, after, h * (1.0 - first))


def _closing_speed(gears: Geared, x: Any) -> Any:
    """Return the speeds at which motors gain on their links (N) [rad/s]."""
    N = gears.joint_count
    return x[2 * N : 3 * N] - x[3 * N :]


def _find_moment(path: tuple[Any, Any, Any, Any, Any], edge: Any) -> Any:
    """Return the fraction of a step at which a cubic path passes an edge."""
    way = path[2] - path[0]
    moment = (edge - path[0]) / ca.if_else(ca.fabs(way) > STILL, way, 1.0)
    for _ in range(ROUNDS):
        slope = hermite_slope(*path, moment)
        off = hermite(*path, moment) - edge
        moment = clip(moment - off / ca.if_else(ca.fabs(slope) > STILL, slope, 1.0), 0.0, 1.0)
    return moment


def measure_compression(model: System, params: Floats, y: Floats, u: Floats) -> Floats:
    """Return the rms angle by which flanks give way to the inputs of a log (N) [rad].

    Args:
        model: a sampled arm with gears.
        params: its numbers.
        y: readings (samples x N or 2 N), whose first ones are taken for both sides of the gears.
        u: inputs (samples x N).
    """
    gears: Any = model.gears
    rate: Any = model.rate
    N = gears.joint_count
    q, push = ca.SX.sym("q", N), ca.SX.sym("push", N)
    open_gaps = ca.SX.zeros(N)
    freely = rate(ca.SX(params), ca.vertcat(q, q, open_gaps, open_gaps), push, open_gaps)
    followed = gears.follow(ca.SX(params))
    pressing = followed.stiffness * _closing_speed(gears, freely)
    given = pressing / followed.contact_stiffness(ca.SX(params))[0]
    seen = np.isfinite(y).all(axis=1)
    along = ca.Function("compression", [q, push], [given]).map(int(seen.sum()))
    angles = np.asarray(along(y[seen, :N].T, u[seen].T))
    return np.sqrt(np.mean(angles**2, axis=1))
