"""Closing the loop: plant, sensor, observer and controller become one CasADi graph."""

from __future__ import annotations

import casadi as ca
import numpy as np

from undeadzone.ends.actuator import Drive
from undeadzone.ends.sensor import Zone
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Compensator, Controller, Observer
from undeadzone.numerics.dense_output import StepAttempt
from undeadzone.plants.system import System
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
from undeadzone.simulation.steps import located_steps, plain_step
from undeadzone.simulation.wiring import Wiring
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
