"""Closing the loop: plant, sensor, observer and controller become one CasADi graph, next_state, outputs = step(state, exogenous, params)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone import tree
from undeadzone.controllers import Controller
from undeadzone.feedforward import Target
from undeadzone.observers import Observer, Reading
from undeadzone.plant import System
from undeadzone.sensor import Zone, branch, deadzone, edges, jump, side, zone
from undeadzone.switching import Crossing, located_step


class Exogenous(NamedTuple):
    """What comes from outside at one instant: target, disturbance w (m), noise ahead of and after the zone (p each)."""

    target: Target
    w: Any
    before: Any
    after: Any


class SensorParams(NamedTuple):
    """d_r, d_l, m and the silence threshold (p each)."""

    right: Any
    left: Any
    slope: Any
    threshold: Any


class Params(NamedTuple):
    """Every number of the loop, given at run time; h is the time step [s]."""

    plant: Any
    sensor: SensorParams
    observer: Any
    controller: Any
    h: Any


class State(NamedTuple):
    """The loop's state."""

    plant: Any
    observer: Any
    controller: Any


class Outputs(NamedTuple):
    """What is recorded at the start of each step."""

    x: Any
    z: Any
    y: Any
    side: Any
    u: Any
    x_hat: Any
    z_hat: Any
    right: Any
    left: Any
    z_inverse: Any
    innovation: Any
    x_std: Any
    right_std: Any
    left_std: Any
    width_std: Any
    innovation_std: Any


class Loop(NamedTuple):
    """The closed loop: step(state, exogenous, params) -> (next state, outputs), and the numbers that start it.

    In continuous time the exogenous input holds three instants: the step's start, middle and end.
    """

    step: ca.Function
    state: State
    params: Params
    outputs: Outputs


class _Mode(NamedTuple):
    """A branch of the sensor, held fixed within a step: where z is, and which side is read."""

    zone: Any
    side: Any


def close(plant: System, sensor: Zone, observer: Observer, controller: Controller, tracked: int, step: float) -> Loop:
    """The closed loop of a plant (continuous, or sampled when plant.Ts is set) stepping by `step` [s]."""
    params = Params(
        plant.params, SensorParams(sensor.right, sensor.left, sensor.slope, sensor.threshold), observer.params, controller.params, np.float64(step)
    )  # fmt: skip
    state = State(np.zeros(plant.n), observer.init(observer.params), controller.init(controller.params))
    instant = Exogenous(Target(np.zeros(tracked), np.zeros(plant.n), np.zeros(plant.m)), np.zeros(plant.m), np.zeros(plant.p), np.zeros(plant.p))
    p_column, p = tree.symbols(params, "p")
    s_column, s = tree.symbols(state, "s")
    wires = _Wires(plant, sensor.kind, observer, controller, p)
    if plant.Ts is not None:
        w_column, w = tree.symbols(instant, "w")
        rate, outputs = wires.move(s, w, wires.mode(s, w))
        following = tree.stack(rate)
    else:
        columns, parts = zip(*(tree.symbols(instant, f"w{i}") for i in range(3)), strict=True)
        w_column = ca.vertcat(*columns)
        _, outputs = wires.move(s, parts[0], wires.mode(s, parts[0]))
        following = _located_step(wires, state, instant, s_column, columns, p.h)
    function = ca.Function("step", [s_column, w_column, p_column], [following, tree.stack(outputs)], ["s", "w", "p"], ["next", "out"], {"cse": True})
    shapes = Outputs(*(np.zeros(value.shape[0]) for value in outputs))
    return Loop(function, state, params, shapes)


class _Wires(NamedTuple):
    """The loop's parts with symbolic params, ready to be evaluated at a state."""

    plant: System
    kind: str
    observer: Observer
    controller: Controller
    p: Params

    def mode(self, s: State, w: Exogenous) -> _Mode:
        """The branch at a state."""
        z = self.plant.output(self.p.plant, s.plant)
        right, left, slope, threshold = self.p.sensor
        read = (jump if self.kind == "jump" else deadzone)(z + w.before, right, left, slope) + w.after
        return _Mode(zone(z + w.before, right, left), side(read, threshold))

    def move(self, s: State, w: Exogenous, mode: _Mode) -> tuple[State, Outputs]:
        """The state's derivative (or next value) and the outputs, on a given branch of the sensor."""
        right, left, slope, _ = self.p.sensor
        s = self.project(s)
        z = self.plant.output(self.p.plant, s.plant)
        y = branch(z + w.before, mode.zone, right, left, slope, self.kind) + w.after
        reading = Reading(y, mode.side)
        _, estimate = self.observer.step(self.p.observer, s.observer, ca.SX.sym("unused", self.plant.m), reading)
        controller, u = self.controller.step(self.p.controller, s.controller, estimate, w.target)
        observer, _ = self.observer.step(self.p.observer, s.observer, u, reading)
        plant = self.plant.move(self.p.plant, s.plant, u + w.w)
        return State(plant, observer, controller), Outputs(s.plant, z, y, mode.side, u, *estimate)

    def project(self, s: State) -> State:
        """The admissible state nearest to s."""
        return s._replace(observer=self.observer.project(self.p.observer, s.observer))


def _located_step(wires: _Wires, like: State, instant: Exogenous, start: ca.SX, columns: tuple[ca.SX, ...], h: ca.SX) -> ca.SX:
    """RK4 with the change of side located inside the step (`switching.located_step`).

    A change of zone that leaves the side as it is (noise beyond the threshold) is not located.
    """
    right, left, slope, threshold = wires.p.sensor
    noise: Exogenous = tree.unpack(instant, columns[0])
    drawn = 2 * wires.plant.p  # entries at the end, noise, which is held

    def at(c: Any) -> ca.SX:
        """The exogenous inputs at a fraction c of the step: quadratic between the three instants, noise held."""
        if isinstance(c, float):
            return columns[round(2 * c)]
        first, middle, last = (column[:-drawn] for column in columns)
        return ca.vertcat(first + c * (4 * middle - 3 * first - last + c * (2 * (first + last) - 4 * middle)), columns[0][-drawn:])

    w = ca.SX.sym("w", columns[0].shape[0])
    branch_taken = _Mode(*(ca.SX.sym(name, wires.plant.p) for name in _Mode._fields))
    derivative = tree.stack(wires.move(tree.unpack(like, start), tree.unpack(instant, w), branch_taken)[0])
    evaluate = ca.Function("rate", [start, w, *branch_taken], [derivative], {"allow_free": True})

    def rate(column: ca.SX, c: Any, mode: _Mode) -> ca.SX:
        return evaluate(column, at(c), *mode)

    def output(column: ca.SX) -> ca.SX:
        return wires.plant.output(wires.p.plant, tree.unpack(like, column).plant)

    before = wires.mode(tree.unpack(like, start), noise)
    above, below = edges(right, left, slope, wires.kind, threshold, noise.after)

    def after(crossing: Crossing) -> _Mode:
        edge = ca.if_else(crossing.upper, above, -below)
        # On an edge itself, motion decides which zone follows.
        rising, falling = 1.0 * (edge >= right) - 1.0 * (edge < -left), 1.0 * (edge > right) - 1.0 * (edge <= -left)
        entered = _Mode(ca.if_else(crossing.rising, rising, falling), crossing.side)
        return _Mode(*(ca.if_else(crossing.changed, new, old) for new, old in zip(entered, before, strict=True)))

    levels = (above - noise.before, -below - noise.before)
    following = located_step(rate, output, levels, before, after, start, h)
    return tree.stack(wires.project(tree.unpack(like, following)))
