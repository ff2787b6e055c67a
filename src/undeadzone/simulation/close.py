"""Closing the loop: plant, sensor, observer and controller become one CasADi graph."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Compensator, Controller, Estimate, Observer, Reading
from undeadzone.nonlinearities.actuator import (
    command_memory,
    pass_command,
    through_line,
    through_zone,
)
from undeadzone.nonlinearities.limits import at_limit
from undeadzone.nonlinearities.play import apply_backlash, contact
from undeadzone.nonlinearities.sensor import branch, edges, quantise, side, zone
from undeadzone.numerics import dense_output
from undeadzone.numerics.clip import clip
from undeadzone.numerics.dense_output import Levels
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.plants.system import System
from undeadzone.scenario.problem import Problem
from undeadzone.simulation import loop
from undeadzone.simulation.loop import Driven, Exogenous, Outputs, Params, State
from undeadzone.util import tree


class Mode(NamedTuple):
    """A branch of the sensor, held fixed within a step.

    Attributes:
        zone: place of z (p): +1 beyond d_r, -1 below -d_l, 0 inside.
        side: which side is read (p), +2 or -2 at a limit of the range.
    """

    zone: Any
    side: Any


class Wiring(NamedTuple):
    """The loop's parts with symbolic params, ready to be evaluated at a state.

    Attributes:
        plant, observer, controller: the parts.
        kind: of the sensor.
        p: the params, as symbols.
        compensator: of the actuator's dead zone (None: there is none).
    """

    plant: System
    kind: str
    observer: Observer
    controller: Controller
    p: Params
    compensator: Compensator | None = None

    def mode(self, s: State, w: Exogenous) -> Mode:
        """Return the branch at a state."""
        right, left = self.widths(w)
        z = self.ahead_of_zone(s, w)
        side = ca.SX(0.0)
        for above, below in zip(*self.levels(w), strict=True):
            side += 1.0 * (z > above) - 1.0 * (z < below)
        return Mode(zone(z, right, left), side)

    def ahead_of_zone(self, s: State, w: Exogenous) -> ca.SX:
        """Return the input of the dead zone: z with noise, or the level of a play (p)."""
        z = self.plant.read(self.p.plant, s.plant)
        sensor = self.p.sensor
        if sensor.gap_right.numel():
            return apply_backlash(ca, z, s.sensor, sensor.gap_right, sensor.gap_left)
        return z + w.before

    def levels(self, w: Exogenous) -> Levels:
        """Return levels of z, noise ahead of the zone included (p each).

        The side is right if z lies above the first upper one, left if z lies below the first lower
        one. Beyond the second ones the reading is at a limit of its range.
        """
        sensor = self.p.sensor

        def level(high: Any, low: Any) -> tuple[Any, Any]:
            above, _ = edges(*self.widths(w), sensor.slope, self.kind, high, w.after)
            _, below = edges(*self.widths(w), sensor.slope, self.kind, -low, w.after)
            return above, -below

        pairs = [level(sensor.threshold, -sensor.threshold)]
        if sensor.limits is not None:
            pairs.append(level(sensor.limits.high, sensor.limits.low))
        return Levels(*zip(*pairs, strict=True))

    def widths(self, w: Exogenous) -> tuple[ca.SX, ca.SX]:
        """Return d_r, d_l at an instant (p each). Encoders of an arm with gears have none."""
        if self.kind == "gears":
            return ca.SX.zeros(self.plant.p), ca.SX.zeros(self.plant.p)
        return self.p.sensor.right * (1 + w.right), self.p.sensor.left * (1 + w.left)

    def exogenous(self, instant: Exogenous, column: ca.SX) -> Exogenous:
        """Return the exogenous inputs of one instant, scaled.

        A missing reading is noise that is not a number. Its side is 0.

        Args:
            instant: the shapes of the exogenous inputs.
            column: their numbers, unscaled, one below the other.
        """
        w: Exogenous = tree.unpack_column(instant, column)
        scale = self.p.scale
        scaled = Target(*(part * scale.reference for part in w.target[:3]))
        return w._replace(
            target=scaled._replace(plan=w.target.plan),
            w=w.w * scale.disturbance,
            before=w.before * scale.before,
            after=w.after * scale.after + w.lost,
        )

    def move(self, s: State, w: Exogenous, mode: Mode) -> tuple[State, Outputs]:
        """Return the state's derivative (or next value) and the outputs, on a given branch."""
        z = self.plant.output(self.p.plant, s.plant)
        level = s.sensor
        if self.kind == "play":
            level = apply_backlash(ca, z, s.sensor, *self.widths(w))
            mode = Mode(mode.zone, contact(level, s.sensor))
        elif self.p.sensor.gap_right.numel():
            level = self.ahead_of_zone(s, w)
        reading = self._sensor_reading(self.ahead_of_zone(s, w), level, s, w, mode)
        driven, u, estimate = self.advance_controller(s, reading, w.target)
        line, acting = through_line(s.line, u)
        actuator, entering = self._actuate(s, acting)
        if self.p.sensor.friction.numel():  # of the load, while it is pushed
            entering = entering - self.p.sensor.friction * contact(level, s.sensor)
        plant = self.plant.move(self.p.plant, s.plant, entering + w.w)
        outputs = Outputs(s.plant, z, reading.y, reading.side, u, estimate)
        after = State(plant, sensor=level, actuator=actuator, line=line, **driven._asdict())
        return after, outputs

    def advance_controller(
        self, s: State | Driven, reading: Reading, target: Target
    ) -> tuple[Driven, ca.SX, Estimate]:
        """Return the state after a reading, and the resulting input within the drives' limits.

        Args:
            s: the states of observer, controller and compensator.
            reading: of the sensor.
            target: the controller's target.

        Returns:
            The derivatives of these states (or next values), the input (m), and the estimate.
        """
        unused = ca.SX.sym("unused", self.plant.m)  # an estimate does not depend on u
        observer, estimate = self.observer.step(self.p.observer, s.observer, unused, reading)
        controller, u = self.controller.step(self.p.controller, s.controller, estimate, target)
        compensator = s.compensator
        if self.compensator is not None:
            parts = self.p.compensator, s.compensator, u, estimate, reading
            compensator, u = self.compensator.step(*parts)
        if self.plant.limit is not None:
            u = clip(u, -self.plant.limit, self.plant.limit)
        return (
            Driven(tree.substitute_symbol(observer, unused, u), controller, compensator),
            u,
            estimate,
        )

    def _actuate(self, s: State, u: ca.SX) -> tuple[Any, ca.SX]:
        """Return (the actuator's next state, the plant's input) for a command u (m)."""
        drive = self.p.actuator
        if drive is None:
            return s.actuator, u
        next_state, passed = pass_command(ca, u, s.actuator, drive, self.p.h)
        return next_state, through_zone(ca, passed, drive)

    def _sensor_reading(
        self, z: ca.SX, level: ca.SX, s: State, w: Exogenous, mode: Mode
    ) -> Reading:
        """Return the reading for `ahead_of_zone` (p) on a given branch (level: of a play)."""
        sensor = self.p.sensor
        limits = self.p.sensor.limits
        read = mode.side
        if self.kind == "play":
            y = sensor.slope * level + w.after
        else:
            y = branch(z, mode.zone, *self.widths(w), sensor.slope, self.kind) + w.after
        if limits is not None and self.plant.Ts is None:  # the branch shows when it is at a limit
            y = ca.if_else(read > 1, limits.high, y)
            return Reading(ca.if_else(read < -1, limits.low, y), read, s.plant)
        rounded = sensor.quantum.numel() > 0
        y = self._within_range(quantise(y, sensor.quantum) if rounded else y)
        if self.kind == "play" and limits is not None:
            end = at_limit(y, limits)
            read = ca.if_else(end != 0, 2 * end, read)
        elif self.kind != "play" and rounded:
            read = side(y, sensor.threshold, limits)
        elif limits is not None:
            read = clip(read, -1.0, 1.0) + at_limit(y, limits)
        return Reading(y, read, s.plant)

    def _within_range(self, y: ca.SX) -> ca.SX:
        """Return a reading limited to its range, if any. A missing reading stays missing."""
        limits = self.p.sensor.limits
        if limits is None:
            return y
        y = ca.if_else(y > limits.high, limits.high, y)
        return ca.if_else(y < limits.low, limits.low, y)

    def admissible(self, like: State, column: ca.SX) -> ca.SX:
        """Return the admissible state nearest to a column, as a column.

        Args:
            like: a state of the right shapes.
            column: the numbers of a state.
        """
        s: State = tree.unpack_column(like, column)
        return tree.stack_leaves(
            s._replace(observer=self.observer.project(self.p.observer, s.observer))
        )


def close(problem: Problem) -> loop.Loop:
    """Return the closed loop of a problem. The estimate of an observer in Python is written into
    it.

    In continuous time it finds changes of side inside a step if simulation.switching is "located".
    Else every stage of RK4 reads its own side. With simulation.order above 4 it takes Taylor series
    (`build_taylor_arcs`), whose exogenous inputs are `order` coefficients of a step in place of
    three instants.

    Raises:
        InputError: a Taylor series was chosen, and the loop is not linear on its branches; or the
            plant is a signal.
    """
    plant = problem.plant
    if not plant.m:
        raise InputError(
            "plant.kind: a signal has no input, so there is no loop to run. Give its readings to "
            "watch or estimate. export writes its filter as C"
        )
    simulation = problem.scenario.simulation
    params = loop_numbers(problem)
    state = _state(problem)
    instant = _instant(problem)
    p_column, p = tree.create_symbols(params, "p")
    s_column, s = tree.create_symbols(state, "s")
    own = problem.observer, problem.controller
    wiring = Wiring(plant, problem.sensor.kind, *own, p, problem.compensator)
    count = loop.instants(plant.Ts, simulation.order)
    columns = [ca.SX.sym(f"w{i}", tree.count_numbers(instant)) for i in range(count)]
    w = wiring.exogenous(instant, columns[0])
    moved, outputs = wiring.move(s, w, wiring.mode(s, w))
    inputs = [s_column, ca.vertcat(*columns), p_column]
    out = tree.stack_leaves(outputs)
    step = _Step(wiring, state, instant, s_column, columns)
    attempts = []
    if plant.Ts is not None:
        following = tree.stack_leaves(moved)
    elif simulation.switching != "located":
        following = _plain(step)
    else:
        attempts = _located_attempts(step, simulation.order)
        following = _first_that_suffices(attempts)
    # At once: the search for common subexpressions takes longest.
    following, out, *ends = ca.cse([following, out, *itertools.chain(*attempts)])
    parts = _in_parts(ends, inputs, out) if attempts else None
    shapes = tree.map_leaves(lambda leaf: np.zeros(leaf.shape[0]), outputs)
    whole = _function("step", inputs, next=following, out=out)
    return loop.Loop(whole, state, params, shapes, instant, parts)


def loop_numbers(problem: Problem) -> loop.Params:
    """Return the numbers of a loop."""
    plant = problem.plant
    sensor = problem.sensor
    none = np.empty(0)
    ahead = sensor.play
    undoing = problem.compensator
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
    """Return the state of a loop at its start, but for that of the plant, which is 0."""
    plant = problem.plant
    sensor = problem.sensor
    drive = problem.actuator
    observer = problem.observer
    controller = problem.controller
    undoing = problem.compensator
    return loop.State(
        plant=np.zeros(plant.n),
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
        sensor=sensor.start if sensor.moves else np.zeros(0),
        compensator=None if undoing is None else undoing.init(undoing.params),
        actuator=np.zeros(0)
        if drive is None
        else command_memory(drive, plant.m, plant.Ts is not None),
        line=np.zeros(plant.delay * plant.m),
    )


def no_target(problem: Problem) -> Target:
    """Return zeros of the shapes of the controller's target."""
    sizes = len(problem.tracked), problem.plant.n, problem.plant.m, problem.controller.plan_size
    return Target(*map(np.zeros, sizes))


def _instant(problem: Problem) -> loop.Exogenous:
    """Return zeros of the shapes of the exogenous inputs at one instant."""
    plant = problem.plant
    zoh_inputs = np.zeros((loop.ZOH_INPUTS, plant.p))
    return loop.Exogenous(no_target(problem), np.zeros(plant.m), *zoh_inputs)


def _first_that_suffices(attempts: list[dense_output.StepAttempt]) -> ca.SX:
    """Return the end of the first attempt that needs no further one, or of the last."""
    *earlier, last = attempts
    following = last.end
    for attempt in reversed(earlier):
        following = ca.if_else(attempt.more, following, attempt.end)
    return following


def _in_parts(attempts: list[ca.SX], inputs: list[ca.SX], out: ca.SX) -> loop.Parts:
    """Return the step as one function for each attempt: of its end, and whether there may be
    more.
    """
    end, more, *others = attempts
    usual = _function("usual", inputs, next=end, out=out, flag=more)
    pairs = zip(others[::2], others[1::2], strict=True)
    rare = [_function("rare", inputs, next=end, flag=more) for end, more in pairs]
    return loop.Parts(usual, tuple(rare))


def _function(name: str, inputs: list[ca.SX], **results: ca.SX) -> ca.Function:
    """Return a function of state, exogenous inputs and params with named results."""
    return ca.Function(name, inputs, list(results.values()), ["s", "w", "p"], list(results))


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
        """Return a state inside the step within its bounds, as the state at the start is."""
        return column if column is self.start else self.wiring.admissible(self.like, column)


def _plain(step: _Step) -> ca.SX:
    """Return the state after an RK4 step that takes the side at each stage anew. Noise is held.

    Its error is of order h^2 if the side changes.
    """
    wiring = step.wiring

    def rate(column: ca.SX, c: float) -> ca.SX:
        s = tree.unpack_column(step.like, step.admissible(column))
        w = wiring.exogenous(step.instant, exogenous_at(step.columns, c, wiring.plant.p))
        return tree.stack_leaves(wiring.move(s, w, wiring.mode(s, w))[0])

    return wiring.admissible(step.like, rk4(rate, step.start, wiring.p.h))


def exogenous_at(columns: list[ca.SX], c: Any, p: int) -> ca.SX:
    """Return the exogenous inputs at a fraction of the step: quadratic, but for those of zero
    order.

    Args:
        columns: the inputs at the step's start, middle and end.
        c: the fraction: 0.0, 0.5 or 1.0, or a CasADi expression.
        p: number of outputs.
    """
    first, middle, last = (column[: -loop.ZOH_INPUTS * p] for column in columns)
    zoh_inputs = columns[0][-loop.ZOH_INPUTS * p :]
    if isinstance(c, float):
        return ca.vertcat(columns[round(2 * c)][: -loop.ZOH_INPUTS * p], zoh_inputs)
    curvature = 2 * (first + last) - 4 * middle
    slope = 4 * middle - 3 * first - last
    return ca.vertcat(first + c * (slope + c * curvature), zoh_inputs)


def _located_attempts(step: _Step, order: int) -> list[dense_output.StepAttempt]:
    """Return attempts at a step with its changes of side located (`locate_side_changes`).

    A change of zone that leaves the side as it is (noise beyond the threshold) is not located.

    Args:
        step: the step.
        order: RUNGE_KUTTA, or that of a Taylor series.

    Raises:
        InputError: a Taylor series was chosen, and the loop is not linear on its branches.
    """
    wiring = step.wiring
    like = step.like
    noise = wiring.exogenous(step.instant, step.columns[0])
    right, left = wiring.widths(noise)
    arc = _dense_step(step, order)
    before = wiring.mode(tree.unpack_column(like, step.start), noise)
    edges = wiring.levels(noise)

    def mode_after_crossing(mode: Mode, crossing: dense_output.Crossing) -> Mode:
        edge = dense_output.next_level(edges, mode.side, crossing.rising)
        return branch_after_crossing(mode, crossing, edge, right, left)

    levels = dense_output.Levels(*(tuple(edge - noise.before for edge in part) for part in edges))
    attempts = dense_output.locate_side_changes(
        arc, levels, before, mode_after_crossing, step.start
    )
    return [attempt._replace(end=wiring.admissible(like, attempt.end)) for attempt in attempts]


def branch_after_crossing(
    mode: Mode, crossing: dense_output.Crossing, edge: ca.SX, right: ca.SX, left: ca.SX
) -> Mode:
    """Return the branch after a crossing.

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
    """Return a step on a fixed branch that can be evaluated inside: RK4, or a Taylor series."""
    wiring = step.wiring
    size = step.start.shape[0]
    h = step.wiring.p.h
    x = ca.SX.sym("x", size)
    w = ca.SX.sym("w", step.columns[0].shape[0])
    branch = Mode(*(ca.SX.sym(name, wiring.plant.p) for name in Mode._fields))
    s = tree.unpack_column(step.like, x)
    inputs = wiring.exogenous(step.instant, w)
    derivative = tree.stack_leaves(wiring.move(s, inputs, branch)[0])
    evaluate = ca.Function("rate", [x, w, *branch], [derivative], {"allow_free": True})

    def output(column: ca.SX) -> ca.SX:
        return wiring.plant.output(wiring.p.plant, tree.unpack_column(step.like, column).plant)

    def rate(column: ca.SX, c: Any, mode: Mode) -> ca.SX:
        at_c = exogenous_at(step.columns, c, wiring.plant.p)
        return evaluate(step.admissible(column), at_c, *mode)

    def rate_of_series(column: ca.SX, series: ca.SX, mode: Mode) -> ca.SX:
        return evaluate(column, series, *mode)

    if order == loop.RUNGE_KUTTA:
        return dense_output.build_rk4_arcs(rate, output, size, h)
    nonlinear_rate = any(ca.which_depends(derivative, ca.vertcat(x, w), 2, True))
    if nonlinear_rate or any(ca.which_depends(output(x), x, 2, True)):
        raise InputError(
            "simulation.order: above 4 only for a plant, an observer and a controller that are "
            "linear on each side of the zone. Use 4"
        )
    return dense_output.build_taylor_arcs(rate_of_series, output, step.columns, size, h)
