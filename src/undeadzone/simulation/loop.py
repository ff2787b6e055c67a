"""Closing the loop: plant, sensor, observer and controller become one CasADi graph, next_state, outputs = step(state, exogenous, params)."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate, Observer, Reading
from undeadzone.numerics.dense_output import runge_kutta, taylor
from undeadzone.numerics.event_location import Crossing, StepAttempt, located_step
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, branch, edges, quantised, side, zone
from undeadzone.support import tree

RUNGE_KUTTA = 4  # the order that needs no Taylor series
HELD = 5  # exogenous inputs of an output that keep their value within a step: the last ones


class Exogenous(NamedTuple):
    """What comes from outside at one instant: target, disturbance w (m), standard normal noise ahead of and after the zone (p each).

    right, left: how much wider than at first an edge is, relative (p each); lost: NaN where the reading is missing, else 0 (p).
    """

    target: Target
    w: Any
    before: Any
    after: Any
    right: Any
    left: Any
    lost: Any


class SensorParams(NamedTuple):
    """d_r, d_l at t = 0, m, the silence threshold and the quantum of the reading (p each; no quantum where nothing is quantised)."""

    right: Any
    left: Any
    slope: Any
    threshold: Any
    quantum: Any


class Scale(NamedTuple):
    """Factors on the exogenous inputs: reference (1), disturbance (m), rms of the noise ahead of and after the zone (p each)."""

    reference: Any
    disturbance: Any
    before: Any
    after: Any


class Params(NamedTuple):
    """Every number of the loop, given at run time; h is the time step [s]."""

    plant: Any
    sensor: SensorParams
    observer: Any
    controller: Any
    scale: Scale
    h: Any


class State(NamedTuple):
    """The loop's state."""

    plant: Any
    observer: Any
    controller: Any


class Outputs(NamedTuple):
    """What is recorded at the start of each step.

    Attributes:
        x: state (n).
        z: output C x (p).
        y: reading (p).
        side: measured side (p).
        u: input (m).
        estimate: what the observer makes of the reading.
    """

    x: Any
    z: Any
    y: Any
    side: Any
    u: Any
    estimate: Estimate


class Parts(NamedTuple):
    """A step in parts: usual(s, w, p) -> (next, out, flag), right where flag is 0; else rare[0](s, w, p) -> (next, flag), and so on.

    The last of them is right in any case.
    """

    usual: ca.Function
    rare: tuple[ca.Function, ...]


class Loop(NamedTuple):
    """The closed loop: step(state, exogenous, params) -> (next state, outputs), and the numbers that start it.

    In continuous time the exogenous input holds three instants: the step's start, middle and end, and `parts` is the
    same step split into what runs each time and what a change of side asks for.
    """

    step: ca.Function
    state: State
    params: Params
    outputs: Outputs
    instant: Exogenous
    parts: Parts | None


class _Mode(NamedTuple):
    """A branch of the sensor, held fixed within a step: where z is, and which side is read."""

    zone: Any
    side: Any


def close(
    plant: System,
    sensor: Zone,
    observer: Observer,
    controller: Controller,
    tracked: int,
    step: float,
    located: bool = True,
    order: int = 4,
) -> Loop:
    """The closed loop of a plant (continuous, or sampled when plant.Ts is set) stepping by `step` [s].

    located: find a change of side inside a continuous step; else plain RK4, whose every stage reads its own side.
    order: 4 for RK4, more for Taylor series (`switching.taylor`), whose exogenous inputs are `order` coefficients of a
    step instead of three instants. Raises InputError where a loop is not linear on its branches.
    """
    scale = Scale(np.float64(1.0), np.ones(plant.m), sensor.noise_before, sensor.noise)
    widths = SensorParams(
        sensor.right,
        sensor.left,
        sensor.slope,
        sensor.threshold,
        sensor.quantum if sensor.quantum.any() else np.empty(0),
    )
    params = Params(
        plant.params, widths, observer.params, controller.params, scale, np.float64(step)
    )
    state = State(
        np.zeros(plant.n), observer.init(observer.params), controller.init(controller.params)
    )
    target = Target(
        np.zeros(tracked), np.zeros(plant.n), np.zeros(plant.m), np.zeros(controller.planned)
    )
    instant = Exogenous(target, np.zeros(plant.m), *np.zeros((HELD, plant.p)))
    p_column, p = tree.symbols(params, "p")
    s_column, s = tree.symbols(state, "s")
    wires = _Wires(plant, sensor.kind, observer, controller, p)
    columns = [
        ca.SX.sym(f"w{i}", tree.size(instant))
        for i in range(1 if plant.Ts is not None else 3 if order == RUNGE_KUTTA else order)
    ]
    w = wires.exogenous(instant, columns[0])
    moved, outputs = wires.move(s, w, wires.mode(s, w))
    inputs = [s_column, ca.vertcat(*columns), p_column]
    out = tree.stack(outputs)
    parts = None
    if plant.Ts is not None:
        following = tree.stack(moved)
    elif not located:
        following = _plain_step(wires, state, instant, s_column, columns)
    else:
        first, *others = _located_step(wires, state, instant, s_column, columns, order)
        following = functools.reduce(
            lambda later, attempt: ca.if_else(attempt.more, later, attempt.end),
            [*others[-2::-1], first],
            others[-1].end,
        )
        rare = tuple(
            _function("rare", inputs, next=attempt.end, flag=attempt.more) for attempt in others
        )
        parts = Parts(_function("usual", inputs, next=first.end, out=out, flag=first.more), rare)
    sizes = (np.zeros(leaf.shape[0]) for _, leaf in tree.leaves(outputs))
    shapes = tree.rebuild(outputs, sizes)
    return Loop(
        _function("step", inputs, next=following, out=out), state, params, shapes, instant, parts
    )


def _function(name: str, inputs: list[ca.SX], **results: ca.SX) -> ca.Function:
    return ca.Function(
        name, inputs, list(results.values()), ["s", "w", "p"], list(results), {"cse": True}
    )


class _Wires(NamedTuple):
    """The loop's parts with symbolic params, ready to be evaluated at a state."""

    plant: System
    kind: str
    observer: Observer
    controller: Controller
    p: Params

    def mode(self, s: State, w: Exogenous) -> _Mode:
        """The branch at a state."""
        right, left = self.widths(w)
        z = self.plant.output(self.p.plant, s.plant) + w.before
        above, below = self.levels(w)
        return _Mode(zone(z, right, left), 1.0 * (z > above) - 1.0 * (z < below))

    def levels(self, w: Exogenous) -> tuple[ca.SX, ca.SX]:
        """The side is right where z, noise ahead of the zone included, lies above the first, left below the second."""
        above, below = edges(
            *self.widths(w), self.p.sensor.slope, self.kind, self.p.sensor.threshold, w.after
        )
        return above, -below

    def widths(self, w: Exogenous) -> tuple[ca.SX, ca.SX]:
        """d_r, d_l at an instant (p each)."""
        return self.p.sensor.right * (1 + w.right), self.p.sensor.left * (1 + w.left)

    def exogenous(self, instant: Exogenous, column: ca.SX) -> Exogenous:
        """The exogenous inputs of one instant, scaled; a missing reading is noise that is not a number, whose side is silent."""
        w: Exogenous = tree.unpack(instant, column)
        target = Target(*(part * self.p.scale.reference for part in w.target[:3]))._replace(
            plan=w.target.plan
        )
        scale = self.p.scale
        return w._replace(
            target=target,
            w=w.w * scale.disturbance,
            before=w.before * scale.before,
            after=w.after * scale.after + w.lost,
        )

    def move(self, s: State, w: Exogenous, mode: _Mode) -> tuple[State, Outputs]:
        """The state's derivative (or next value) and the outputs, on a given branch of the sensor."""
        z = self.plant.output(self.p.plant, s.plant)
        y = (
            branch(z + w.before, mode.zone, *self.widths(w), self.p.sensor.slope, self.kind)
            + w.after
        )
        read = mode.side
        if self.p.sensor.quantum.numel():
            y = quantised(y, self.p.sensor.quantum)
            read = side(y, self.p.sensor.threshold)
        reading = Reading(y, read, s.plant)
        _, estimate = self.observer.step(
            self.p.observer, s.observer, ca.SX.sym("unused", self.plant.m), reading
        )
        controller, u = self.controller.step(self.p.controller, s.controller, estimate, w.target)
        if self.plant.limit is not None:
            u = ca.fmax(ca.fmin(u, self.plant.limit), -self.plant.limit)
        observer, _ = self.observer.step(self.p.observer, s.observer, u, reading)
        plant = self.plant.move(self.p.plant, s.plant, u + w.w)
        return State(plant, observer, controller), Outputs(s.plant, z, y, read, u, estimate)

    def admissible(self, like: State, column: ca.SX) -> ca.SX:
        """The admissible state nearest to a column."""
        s: State = tree.unpack(like, column)
        return tree.stack(s._replace(observer=self.observer.project(self.p.observer, s.observer)))


def _plain_step(
    wires: _Wires, like: State, instant: Exogenous, start: ca.SX, columns: list[ca.SX]
) -> ca.SX:
    """RK4 that takes the side at each stage anew: error of order h^2 where the side changes; noise held."""

    def rate(column: ca.SX, c: float) -> ca.SX:
        s = tree.unpack(like, column if column is start else wires.admissible(like, column))
        w = wires.exogenous(instant, _at(columns, c, wires.plant.p))
        return tree.stack(wires.move(s, w, wires.mode(s, w))[0])

    return wires.admissible(like, rk4(rate, start, wires.p.h))


def _at(columns: list[ca.SX], c: Any, p: int) -> ca.SX:
    """The exogenous inputs at a fraction c of the step: quadratic between the three instants, but for those that are held."""
    first, middle, last = (column[: -HELD * p] for column in columns)
    held = columns[0][-HELD * p :]
    if isinstance(c, float):
        return ca.vertcat(columns[round(2 * c)][: -HELD * p], held)
    return ca.vertcat(
        first + c * (4 * middle - 3 * first - last + c * (2 * (first + last) - 4 * middle)), held
    )


def _located_step(
    wires: _Wires, like: State, instant: Exogenous, start: ca.SX, columns: list[ca.SX], order: int
) -> list[StepAttempt]:
    """RK4 or a Taylor series with the change of side located inside the step (`switching.located_step`).

    A change of zone that leaves the side as it is (noise beyond the threshold) is not located.
    """
    noise = wires.exogenous(instant, columns[0])
    right, left = wires.widths(noise)
    x, w = ca.SX.sym("x", start.shape[0]), ca.SX.sym("w", columns[0].shape[0])
    branch_taken = _Mode(*(ca.SX.sym(name, wires.plant.p) for name in _Mode._fields))
    derivative = tree.stack(
        wires.move(tree.unpack(like, x), wires.exogenous(instant, w), branch_taken)[0]
    )
    evaluate = ca.Function("rate", [x, w, *branch_taken], [derivative], {"allow_free": True})

    def output(column: ca.SX) -> ca.SX:
        return wires.plant.output(wires.p.plant, tree.unpack(like, column).plant)

    def rate(column: ca.SX, c: Any, mode: _Mode) -> ca.SX:
        return evaluate(
            column if column is start else wires.admissible(like, column),
            _at(columns, c, wires.plant.p),
            *mode,
        )

    if order == RUNGE_KUTTA:
        arc = runge_kutta(rate, output, start.shape[0], wires.p.h)
    else:
        if ca.which_depends(derivative, ca.vertcat(x, w), 2, True) != [False] * start.shape[
            0
        ] or any(ca.which_depends(output(x), x, 2, True)):
            raise InputError(
                "simulation.order: above 4 only for a plant, an observer and a controller that are linear on each side of the zone; use 4"
            )
        arc = taylor(
            lambda column, inputs, mode: evaluate(column, inputs, *mode),
            output,
            columns,
            start.shape[0],
            wires.p.h,
        )

    before = wires.mode(tree.unpack(like, start), noise)
    above, below = wires.levels(noise)

    def after(before: _Mode, crossing: Crossing) -> _Mode:
        edge = ca.if_else(crossing.upper, above, below)
        # On an edge itself, motion decides which zone follows.
        rising, falling = (
            1.0 * (edge >= right) - 1.0 * (edge < -left),
            1.0 * (edge > right) - 1.0 * (edge <= -left),
        )
        entered = _Mode(ca.if_else(crossing.rising, rising, falling), crossing.side)
        return _Mode(
            *(
                ca.if_else(crossing.changed, new, old)
                for new, old in zip(entered, before, strict=True)
            )
        )

    levels = (above - noise.before, below - noise.before)
    attempts = located_step(arc, levels, before, after, start)
    return [attempt._replace(end=wires.admissible(like, attempt.end)) for attempt in attempts]
