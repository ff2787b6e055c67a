"""Closing the loop: plant, sensor, observer and controller become one CasADi graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.ends.actuator import Drive
from undeadzone.ends.sensor import Zone
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Compensator, Controller, Observer
from undeadzone.numerics.dense_output import (
    Crossing,
    DenseStep,
    Levels,
    StepAttempt,
    located_step,
    met,
    runge_kutta,
    taylor,
)
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.loop import (
    HELD,
    RUNGE_KUTTA,
    Exogenous,
    Loop,
    Params,
    Parts,
    Scale,
    SensorParams,
    State,
)
from undeadzone.simulation.wiring import Mode, Wiring
from undeadzone.support import tree


def close(
    plant: System,
    sensor: Zone,
    observer: Observer,
    controller: Controller,
    tracked: int,
    step: float,
    located: bool = True,
    order: int = RUNGE_KUTTA,
    compensator: Compensator | None = None,
    actuator: Drive | None = None,
) -> Loop:
    """The closed loop of a plant.

    Args:
        plant: continuous, or sampled when plant.Ts is set.
        sensor: the dead zone.
        observer: the observer, a graph.
        controller: the controller.
        tracked: how many outputs follow the reference.
        step: time step [s].
        located: find a change of side inside a continuous step; else plain RK4, whose every stage
            reads its own side.
        order: 4 for RK4, more for Taylor series (`dense_output.taylor`), whose exogenous inputs
            are `order` coefficients of a step in place of three instants.
        compensator: what makes the actuator's command of the controller's input; None: nothing.
        actuator: ahead of the plant; None: there is none.

    Raises:
        InputError: a Taylor series was asked for, and the loop is not linear on its branches.
    """
    params = numbers(plant, sensor, observer, controller, step, compensator, actuator)
    rated = actuator is not None and actuator.rated
    state = State(
        plant=np.zeros(plant.n),
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
        sensor=sensor.start if sensor.moves else np.zeros(0),
        compensator=None if compensator is None else compensator.init(compensator.params),
        actuator=np.zeros(plant.m if rated else 0),
    )
    instant = _instant(plant, controller, tracked)
    p_column, p = tree.symbols(params, "p")
    s_column, s = tree.symbols(state, "s")
    wiring = Wiring(plant, sensor.kind, observer, controller, p, compensator)
    columns = _exogenous_columns(plant, instant, order)
    w = wiring.exogenous(instant, columns[0])
    moved, outputs = wiring.move(s, w, wiring.mode(s, w))
    inputs = [s_column, ca.vertcat(*columns), p_column]
    out = tree.stack(outputs)
    parts = None
    if plant.Ts is not None:
        following = tree.stack(moved)
    elif not located:
        following = plain_step(wiring, state, instant, s_column, columns)
    else:
        attempts = located_steps(wiring, state, instant, s_column, columns, order)
        following = _first_that_suffices(attempts)
        parts = _in_parts(attempts, inputs, out)
    sizes = (np.zeros(leaf.shape[0]) for _, leaf in tree.leaves(outputs))
    shapes = tree.rebuild(outputs, sizes)
    whole = _function("step", inputs, next=following, out=out)
    return Loop(whole, state, params, shapes, instant, parts)


def loop_of(problem: Problem) -> Loop:
    """The closed loop of a problem; the estimate of an observer in Python is written into it."""
    simulation = problem.scenario.simulation
    return close(
        problem.plant,
        problem.sensor,
        problem.observer,
        problem.controller,
        len(problem.tracked),
        simulation.step,
        simulation.switching == "located",
        simulation.order,
        problem.compensator,
        problem.actuator,
    )


def numbers(
    plant: System,
    sensor: Zone,
    observer: Observer,
    controller: Controller,
    step: float,
    compensator: Compensator | None = None,
    actuator: Drive | None = None,
) -> Params:
    """The numbers of a loop.

    Args:
        plant, sensor, observer, controller, step, compensator, actuator: as of `close`.
    """
    scale = Scale(np.float64(1.0), np.ones(plant.m), sensor.noise_before, sensor.noise)
    quantum = sensor.quantum if sensor.quantum.any() else np.empty(0)
    widths = sensor.right, sensor.left
    friction = sensor.friction if sensor.friction.any() else np.empty(0)
    none, ahead = np.empty(0), sensor.play
    zone = SensorParams(
        *widths,
        sensor.slope,
        sensor.threshold,
        quantum,
        sensor.limits,
        friction,
        gap_right=none if ahead is None else ahead.right,
        gap_left=none if ahead is None else ahead.left,
    )
    h = np.float64(step)
    undoing = None if compensator is None else compensator.params
    own = (observer.params, controller.params)
    return Params(plant.params, zone, *own, scale, h, undoing, actuator)


def _instant(plant: System, controller: Controller, tracked: int) -> Exogenous:
    """Zeros of the shapes of the exogenous inputs at one instant."""
    target = Target(
        np.zeros(tracked), np.zeros(plant.n), np.zeros(plant.m), np.zeros(controller.planned)
    )
    return Exogenous(target, np.zeros(plant.m), *np.zeros((HELD, plant.p)))


def _exogenous_columns(plant: System, instant: Exogenous, order: int) -> list[ca.SX]:
    """Symbols of the exogenous inputs of a step: one instant, three, or Taylor coefficients."""
    if plant.Ts is not None:
        count = 1
    elif order == RUNGE_KUTTA:
        count = 3
    else:
        count = order
    return [ca.SX.sym(f"w{i}", tree.size(instant)) for i in range(count)]


def _first_that_suffices(attempts: list[StepAttempt]) -> ca.SX:
    """The end of the first attempt that needs no further one, or of the last."""
    *earlier, last = attempts
    following = last.end
    for attempt in reversed(earlier):
        following = ca.if_else(attempt.more, following, attempt.end)
    return following


def _in_parts(attempts: list[StepAttempt], inputs: list[ca.SX], out: ca.SX) -> Parts:
    """The step as one function for each attempt."""
    first, *others = attempts
    rare = [_function("rare", inputs, next=other.end, flag=other.more) for other in others]
    usual = _function("usual", inputs, next=first.end, out=out, flag=first.more)
    return Parts(usual, tuple(rare))


def _function(name: str, inputs: list[ca.SX], **results: ca.SX) -> ca.Function:
    """A function of state, exogenous inputs and params with named results."""
    return ca.Function(
        name, inputs, list(results.values()), ["s", "w", "p"], list(results), {"cse": True}
    )


def plain_step(
    wiring: Wiring, like: State, instant: Exogenous, start: ca.SX, columns: list[ca.SX]
) -> ca.SX:
    """The state after an RK4 step that takes the side at each stage anew; noise is held.

    Its error is of order h^2 where the side changes.

    Args:
        wiring: the parts of the loop.
        like: a state of the right shapes.
        instant: exogenous inputs of the right shapes.
        start: the state at the step's start, as a column.
        columns: the exogenous inputs at the step's start, middle and end.
    """

    def rate(column: ca.SX, c: float) -> ca.SX:
        admissible = column if column is start else wiring.admissible(like, column)
        s = tree.unpack(like, admissible)
        w = wiring.exogenous(instant, exogenous_at(columns, c, wiring.plant.p))
        return tree.stack(wiring.move(s, w, wiring.mode(s, w))[0])

    return wiring.admissible(like, rk4(rate, start, wiring.p.h))


def exogenous_at(columns: list[ca.SX], c: Any, p: int) -> ca.SX:
    """The exogenous inputs at a fraction of the step: quadratic, but for those that are held.

    Args:
        columns: the inputs at the step's start, middle and end.
        c: the fraction: 0.0, 0.5 or 1.0, or a CasADi expression.
        p: number of outputs.
    """
    first, middle, last = (column[: -HELD * p] for column in columns)
    held = columns[0][-HELD * p :]
    if isinstance(c, float):
        return ca.vertcat(columns[round(2 * c)][: -HELD * p], held)
    curvature = 2 * (first + last) - 4 * middle
    slope = 4 * middle - 3 * first - last
    return ca.vertcat(first + c * (slope + c * curvature), held)


def located_steps(
    wiring: Wiring,
    like: State,
    instant: Exogenous,
    start: ca.SX,
    columns: list[ca.SX],
    order: int,
) -> list[StepAttempt]:
    """Attempts at a step with its changes of side located (`event_location.located_step`).

    A change of zone that leaves the side as it is (noise beyond the threshold) is not located.

    Args:
        wiring: the parts of the loop.
        like: a state of the right shapes.
        instant: exogenous inputs of the right shapes.
        start: the state at the step's start, as a column.
        columns: the exogenous inputs at three instants, or their Taylor coefficients.
        order: RUNGE_KUTTA, or that of a Taylor series.

    Raises:
        InputError: a Taylor series was asked for, and the loop is not linear on its branches.
    """
    noise = wiring.exogenous(instant, columns[0])
    right, left = wiring.widths(noise)
    arc = _dense_step(wiring, like, instant, start, columns, order)
    before = wiring.mode(tree.unpack(like, start), noise)
    edges = wiring.levels(noise)

    def after(mode: Mode, crossing: Crossing) -> Mode:
        edge = met(edges, mode.side, crossing.rising)
        return entered(mode, crossing, edge, right, left)

    levels = Levels(*(tuple(edge - noise.before for edge in part) for part in edges))
    attempts = located_step(arc, levels, before, after, start)
    return [attempt._replace(end=wiring.admissible(like, attempt.end)) for attempt in attempts]


def entered(mode: Mode, crossing: Crossing, edge: ca.SX, right: ca.SX, left: ca.SX) -> Mode:
    """The branch after a crossing.

    Args:
        mode: the branch before it.
        crossing: which outputs crossed, and in which direction.
        edge: the level of z that was crossed (p) [z].
        right, left: d_r, d_l (p) [z].
    """
    # On an edge itself, motion decides which zone follows.
    rising = 1.0 * (edge >= right) - 1.0 * (edge < -left)
    falling = 1.0 * (edge > right) - 1.0 * (edge <= -left)
    zone = ca.if_else(crossing.rising, rising, falling)
    return Mode(
        ca.if_else(crossing.changed, zone, mode.zone),
        ca.if_else(crossing.changed, crossing.side, mode.side),
    )


def _dense_step(
    wiring: Wiring,
    like: State,
    instant: Exogenous,
    start: ca.SX,
    columns: list[ca.SX],
    order: int,
) -> Callable[[ca.SX, Any, Any], DenseStep]:
    """A step on a fixed branch that can be evaluated inside: RK4, or a Taylor series."""
    size, h = start.shape[0], wiring.p.h
    x, w = ca.SX.sym("x", size), ca.SX.sym("w", columns[0].shape[0])
    branch_taken = Mode(*(ca.SX.sym(name, wiring.plant.p) for name in Mode._fields))
    s, inputs = tree.unpack(like, x), wiring.exogenous(instant, w)
    derivative = tree.stack(wiring.move(s, inputs, branch_taken)[0])
    evaluate = ca.Function("rate", [x, w, *branch_taken], [derivative], {"allow_free": True})

    def output(column: ca.SX) -> ca.SX:
        return wiring.plant.output(wiring.p.plant, tree.unpack(like, column).plant)

    def rate(column: ca.SX, c: Any, mode: Mode) -> ca.SX:
        admissible = column if column is start else wiring.admissible(like, column)
        return evaluate(admissible, exogenous_at(columns, c, wiring.plant.p), *mode)

    def rate_of_series(column: ca.SX, series: ca.SX, mode: Mode) -> ca.SX:
        return evaluate(column, series, *mode)

    if order == RUNGE_KUTTA:
        return runge_kutta(rate, output, size, h)
    nonlinear_rate = any(ca.which_depends(derivative, ca.vertcat(x, w), 2, True))
    if nonlinear_rate or any(ca.which_depends(output(x), x, 2, True)):
        raise InputError(
            "simulation.order: above 4 only for a plant, an observer and a controller that are "
            "linear on each side of the zone; use 4"
        )
    return taylor(rate_of_series, output, columns, size, h)
