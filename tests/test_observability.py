"""Widths along runs of nonlinear plants: verdicts against theory, the Gramian against runs with other starts and widths."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes import linear, random_plant
from undeadzone.arrays import Floats
from undeadzone.design import observability as design
from undeadzone.design.along import variance, verdicts_along
from undeadzone.design.identifiability import Verdict, unknown_bias, verdicts
from undeadzone.design.observability import Observability, observability
from undeadzone.design.schedule import reading_levels, recorded
from undeadzone.plant import Plant, System, initial_state, sampled, system
from undeadzone.robots.options import ElasticJoint, OneLink, TwoLink
from undeadzone.sensor import Sensor, Zone, deadzone, resolve, zone
from undeadzone.signals import Step

STEP = 2e-3
TABLE = {"g": 0.0}
SWINGING = {  # plants, and torques under which every output passes -0.2 and 0.3
    "pendulum": (Plant(arm=OneLink(reference=-np.pi / 2), x0=[-1.0, 0.0]), lambda t, x: [1.5 * np.sin(3 * t) - 0.1 * x[1]]),
    "upright": (Plant(arm=OneLink(reference=np.pi / 2), x0=[1.6, 0.0]), lambda t, x: [4 * np.sin(3 * t) - 9 * (x[0] - np.pi / 2) - 0.5 * x[1]]),
    "one link on a table": (Plant(arm=OneLink(), parameters=TABLE), lambda t, x: [np.sin(3 * t) - 2 * x[0] - 0.2 * x[1]]),
    "two links": (
        Plant(arm=TwoLink(), x0=[0.5, 0.0, 0.0, 0.0]),
        lambda t, x: [12 * np.cos(x[0]) + 9 * np.sin(2 * t) - 9 * x[0] - 3 * x[2], 3 * np.cos(x[0] + x[1]) + 4 * np.sin(3 * t) - 5 * x[1] - x[3]],
    ),
    "two links on a table": (
        Plant(arm=TwoLink(), parameters=TABLE),
        lambda t, x: [10 * np.sin(2 * t) - 20 * x[0] - 4 * x[2], 8 * np.sin(3 * t) - 10 * x[1] - 2 * x[3]],
    ),
    "speeds of two links on a table": (
        Plant(arm=TwoLink(measured="velocity"), parameters=TABLE),
        lambda t, x: [10 * np.sin(2 * t) - 20 * x[0] - 4 * x[2], 8 * np.sin(3 * t) - 10 * x[1] - 2 * x[3]],
    ),
    "motor of an elastic joint on a table": (Plant(arm=ElasticJoint(measured="motor"), parameters=TABLE), lambda t, x: [8 * np.sin(2 * t) - 9 * x[0] - 2 * x[2]]),
    "motor of an elastic joint": (Plant(arm=ElasticJoint(measured="motor")), lambda t, x: [3 * np.cos(x[1]) + 6 * np.sin(2 * t) - 9 * x[0] - 2 * x[2]]),
    "link of an elastic joint": (Plant(arm=ElasticJoint(measured="link")), lambda t, x: [3 * np.cos(x[1]) + 6 * np.sin(2 * t) - 9 * x[0] - 2 * x[2]]),
    "duffing": (
        Plant(f=["v", "-k*s**3 - c*v + F"], h=["s"], states=["s", "v"], inputs=["F"], parameters={"k": 2.0, "c": 0.5}),
        lambda t, x: [2 * np.sin(1.5 * t)],
    ),
    "a bent integrator": (Plant(f=["F / (1 + s**2)"], h=["s + s**3 / 3"], states=["s"], inputs=["F"]), lambda t, x: [2 * np.sin(2 * t)]),
}


class Trial(NamedTuple):
    """A plant, sampled, and a run of it."""

    model: System
    x: Floats
    u: Floats
    z: Floats
    sensor: Zone

    @property
    def side(self) -> Floats:
        return zone(self.z, *reading_levels(self.sensor).T)

    def verdicts(self, **known: Any) -> list[Verdict]:
        return verdicts_along(self.model, self.x, self.u, self.z, self.sensor, STEP, **known)

    def observability(self, **known: Any) -> Observability:
        return observability(self.model, self.x, self.u, self.side, STEP, variance(self.sensor), **known)


def outputs(model: System, start: Floats, u: Floats) -> tuple[Floats, Floats]:
    """(x, z) of a sampled plant from a start under inputs u."""
    x, w = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    params = ca.SX(model.params) if model.nonlinear else model.params
    step = ca.Function("step", [x, w], [model.move(params, x, w), ca.vertcat(x, model.output(params, x))])
    both = np.asarray(step.mapaccum(len(u))(start, u.T)[1]).T
    return both[:, : model.n], both[:, model.n :]


@functools.cache
def swinging(name: str, duration: float = 6.0, step: float = STEP) -> Trial:
    plant, torque = SWINGING[name]
    model = sampled(system(plant), step, 1)
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    move = ca.Function("move", [x, u], [model.move(ca.SX(model.params), x, u)])
    start = now = initial_state(plant, model.n)
    inputs = []
    for k in range(round(duration / step)):
        inputs.append(np.ravel(torque(k * step, now)))
        now = move(now, inputs[-1]).full().ravel()
    x_all, z = outputs(model, start, np.array(inputs))
    return Trial(model, x_all, np.array(inputs), z, resolve(Sensor(right=0.3, left=0.2), model.p, step))
