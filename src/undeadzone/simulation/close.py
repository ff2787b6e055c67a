"""Closing the loop: plant, sensor, observer and controller become one CasADi graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.numerics import dense_output
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem
from undeadzone.simulation import loop
from undeadzone.simulation.wiring import Mode, Wiring
from undeadzone.support import tree


def close(problem: Problem) -> loop.Loop:
    """The closed loop of a problem; the estimate of an observer in Python is written into it.

    In continuous time it finds changes of side inside a step where simulation.switching is
    "located"; else every stage of RK4 reads its own side. With simulation.order above 4 it takes
    Taylor series (`dense_output.taylor`), whose exogenous inputs are `order` coefficients of a step
    in place of three instants.

    Raises:
        InputError: a Taylor series was asked for, and the loop is not linear on its branches.
    """
    plant, simulation = problem.plant, problem.scenario.simulation
    params, state, instant = numbers(problem), _state(problem), _instant(problem)
    p_column, p = tree.symbols(params, "p")
    s_column, s = tree.symbols(state, "s")
    own = problem.observer, problem.controller
    wiring = Wiring(plant, problem.sensor.kind, *own, p, problem.compensator)
    columns = _exogenous_columns(plant, instant, simulation.order)
    w = wiring.exogenous(instant, columns[0])
    moved, outputs = wiring.move(s, w, wiring.mode(s, w))
    inputs = [s_column, ca.vertcat(*columns), p_column]
    out = tree.stack(outputs)
    step, parts = _Step(wiring, state, instant, s_column, columns), None
    if plant.Ts is not None:
        following = tree.stack(moved)
    elif simulation.switching != "located":
        following = _plain(step)
    else:
        attempts = _located(step, simulation.order)
        following = _first_that_suffices(attempts)
        parts = _in_parts(attempts, inputs, out)
    sizes = (np.zeros(leaf.shape[0]) for _, leaf in tree.leaves(outputs))
    shapes = tree.rebuild(outputs, sizes)
    whole = _function("step", inputs, next=following, out=out)
    return loop.Loop(whole, state, params, shapes, instant, parts)


def numbers(problem: Problem) -> loop.Params:
    """The numbers of a loop."""
    plant, sensor = problem.plant, problem.sensor
    none, ahead, undoing = np.empty(0), sensor.play, problem.compensator
    zone = loop.SensorParams(
        sensor.right,
        sensor.left,
        sensor.slope,
        sensor.threshold,
        sensor.quantum if sensor.quantum.any() else none,
        sensor.limits,
        sensor.friction if sensor.friction.any() else none,
        gap_right=none if ahead is None else ahead.right,
        gap_left=none if ahead is None else ahead.left,
    )
    return loop.Params(
        plant.params,
        zone,
        problem.observer.params,
        problem.controller.params,
        loop.Scale(np.float64(1.0), np.ones(plant.m), sensor.noise_before, sensor.noise),
        np.float64(problem.scenario.simulation.step),
        None if undoing is None else undoing.params,
        problem.actuator,
    )


def _state(problem: Problem) -> loop.State:
    """The state of a loop at its start, but for that of the plant, which is 0."""
    plant, sensor, drive = problem.plant, problem.sensor, problem.actuator
    observer, controller, undoing = problem.observer, problem.controller, problem.compensator
    return loop.State(
        plant=np.zeros(plant.n),
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
        sensor=sensor.start if sensor.moves else np.zeros(0),
        compensator=None if undoing is None else undoing.init(undoing.params),
        actuator=np.zeros(plant.m if drive is not None and drive.rated else 0),
    )


def _instant(problem: Problem) -> loop.Exogenous:
    """Zeros of the shapes of the exogenous inputs at one instant."""
    plant, planned = problem.plant, problem.controller.planned
    target = Target(*map(np.zeros, (len(problem.tracked), plant.n, plant.m, planned)))
    return loop.Exogenous(target, np.zeros(plant.m), *np.zeros((loop.HELD, plant.p)))


def _exogenous_columns(plant: System, instant: loop.Exogenous, order: int) -> list[ca.SX]:
    """Symbols of the exogenous inputs of a step: one instant, three, or Taylor coefficients."""
    if plant.Ts is not None:
        count = 1
    elif order == loop.RUNGE_KUTTA:
        count = 3
    else:
        count = order
    return [ca.SX.sym(f"w{i}", tree.size(instant)) for i in range(count)]


def _first_that_suffices(attempts: list[dense_output.StepAttempt]) -> ca.SX:
    """The end of the first attempt that needs no further one, or of the last."""
    *earlier, last = attempts
    following = last.end
    for attempt in reversed(earlier):
        following = ca.if_else(attempt.more, following, attempt.end)
    return following


def _in_parts(
    attempts: list[dense_output.StepAttempt], inputs: list[ca.SX], out: ca.SX
) -> loop.Parts:
    """The step as one function for each attempt."""
    first, *others = attempts
    rare = [_function("rare", inputs, next=other.end, flag=other.more) for other in others]
    usual = _function("usual", inputs, next=first.end, out=out, flag=first.more)
    return loop.Parts(usual, tuple(rare))


def _function(name: str, inputs: list[ca.SX], **results: ca.SX) -> ca.Function:
    """A function of state, exogenous inputs and params with named results."""
    return ca.Function(
        name, inputs, list(results.values()), ["s", "w", "p"], list(results), {"cse": True}
    )


class _Step(NamedTuple):
    """A continuous step, in symbols.

    Attributes:
        wiring: the parts of the loop.
        like: a state of the right shapes.
        instant: exogenous inputs of the right shapes.
        start: the state at the step's start, as a column.
        columns: the exogenous inputs at three instants, or their Taylor coefficients.
    """

    wiring: Wiring
    like: loop.State
    instant: loop.Exogenous
    start: ca.SX
    columns: list[ca.SX]

    def admissible(self, column: ca.SX) -> ca.SX:
        """A state inside the step as it may be; that at its start is."""
        return column if column is self.start else self.wiring.admissible(self.like, column)

    def exogenous_at(self, c: Any) -> ca.SX:
        """The exogenous inputs at a fraction of the step, as a column."""
        return exogenous_at(self.columns, c, self.wiring.plant.p)


def _plain(step: _Step) -> ca.SX:
    """The state after an RK4 step that takes the side at each stage anew; noise is held.

    Its error is of order h^2 where the side changes.
    """
    wiring = step.wiring

    def rate(column: ca.SX, c: float) -> ca.SX:
        s = tree.unpack(step.like, step.admissible(column))
        w = wiring.exogenous(step.instant, step.exogenous_at(c))
        return tree.stack(wiring.move(s, w, wiring.mode(s, w))[0])

    return wiring.admissible(step.like, rk4(rate, step.start, wiring.p.h))


def exogenous_at(columns: list[ca.SX], c: Any, p: int) -> ca.SX:
    """The exogenous inputs at a fraction of the step: quadratic, but for those that are held.

    Args:
        columns: the inputs at the step's start, middle and end.
        c: the fraction: 0.0, 0.5 or 1.0, or a CasADi expression.
        p: number of outputs.
    """
    first, middle, last = (column[: -loop.HELD * p] for column in columns)
    held = columns[0][-loop.HELD * p :]
    if isinstance(c, float):
        return ca.vertcat(columns[round(2 * c)][: -loop.HELD * p], held)
    curvature = 2 * (first + last) - 4 * middle
    slope = 4 * middle - 3 * first - last
    return ca.vertcat(first + c * (slope + c * curvature), held)


def _located(step: _Step, order: int) -> list[dense_output.StepAttempt]:
    """Attempts at a step with its changes of side located (`event_location.located_step`).

    A change of zone that leaves the side as it is (noise beyond the threshold) is not located.

    Args:
        step: the step.
        order: RUNGE_KUTTA, or that of a Taylor series.

    Raises:
        InputError: a Taylor series was asked for, and the loop is not linear on its branches.
    """
    wiring, like = step.wiring, step.like
    noise = wiring.exogenous(step.instant, step.columns[0])
    right, left = wiring.widths(noise)
    arc = _dense_step(step, order)
    before = wiring.mode(tree.unpack(like, step.start), noise)
    edges = wiring.levels(noise)

    def after(mode: Mode, crossing: dense_output.Crossing) -> Mode:
        edge = dense_output.met(edges, mode.side, crossing.rising)
        return entered(mode, crossing, edge, right, left)

    levels = dense_output.Levels(*(tuple(edge - noise.before for edge in part) for part in edges))
    attempts = dense_output.located_step(arc, levels, before, after, step.start)
    return [attempt._replace(end=wiring.admissible(like, attempt.end)) for attempt in attempts]


def entered(
    mode: Mode, crossing: dense_output.Crossing, edge: ca.SX, right: ca.SX, left: ca.SX
) -> Mode:
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


def _dense_step(step: _Step, order: int) -> Callable[[ca.SX, Any, Any], dense_output.DenseStep]:
    """A step on a fixed branch that can be evaluated inside: RK4, or a Taylor series."""
    wiring, size, h = step.wiring, step.start.shape[0], step.wiring.p.h
    x, w = ca.SX.sym("x", size), ca.SX.sym("w", step.columns[0].shape[0])
    branch_taken = Mode(*(ca.SX.sym(name, wiring.plant.p) for name in Mode._fields))
    s, inputs = tree.unpack(step.like, x), wiring.exogenous(step.instant, w)
    derivative = tree.stack(wiring.move(s, inputs, branch_taken)[0])
    evaluate = ca.Function("rate", [x, w, *branch_taken], [derivative], {"allow_free": True})

    def output(column: ca.SX) -> ca.SX:
        return wiring.plant.output(wiring.p.plant, tree.unpack(step.like, column).plant)

    def rate(column: ca.SX, c: Any, mode: Mode) -> ca.SX:
        return evaluate(step.admissible(column), step.exogenous_at(c), *mode)

    def rate_of_series(column: ca.SX, series: ca.SX, mode: Mode) -> ca.SX:
        return evaluate(column, series, *mode)

    if order == loop.RUNGE_KUTTA:
        return dense_output.runge_kutta(rate, output, size, h)
    nonlinear_rate = any(ca.which_depends(derivative, ca.vertcat(x, w), 2, True))
    if nonlinear_rate or any(ca.which_depends(output(x), x, 2, True)):
        raise InputError(
            "simulation.order: above 4 only for a plant, an observer and a controller that are "
            "linear on each side of the zone; use 4"
        )
    return dense_output.taylor(rate_of_series, output, step.columns, size, h)
