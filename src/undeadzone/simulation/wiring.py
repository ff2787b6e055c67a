"""The parts of a loop wired together: what one of them gives, the next one takes."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from undeadzone.ends.actuator import through_zone, within_limits, within_rate
from undeadzone.ends.limits import at_limit
from undeadzone.ends.play import contact, held
from undeadzone.ends.sensor import branch, edges, quantised, side, zone
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Compensator, Controller, Observer, Reading
from undeadzone.numerics.dense_output import Levels
from undeadzone.plants.system import System
from undeadzone.simulation.loop import Exogenous, Outputs, Params, State
from undeadzone.support import tree


class Mode(NamedTuple):
    """A branch of the sensor, held fixed within a step.

    Attributes:
        zone: where z is (p): +1 beyond d_r, -1 below -d_l, 0 inside.
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
        compensator: of the actuator's dead zone; None: there is none.
    """

    plant: System
    kind: str
    observer: Observer
    controller: Controller
    p: Params
    compensator: Compensator | None = None

    def mode(self, s: State, w: Exogenous) -> Mode:
        """The branch at a state."""
        right, left = self.widths(w)
        z = self.ahead_of_zone(s, w)
        side = ca.SX(0.0)
        for above, below in zip(*self.levels(w), strict=True):
            side += 1.0 * (z > above) - 1.0 * (z < below)
        return Mode(zone(z, right, left), side)

    def ahead_of_zone(self, s: State, w: Exogenous) -> ca.SX:
        """What the dead zone takes: z with the noise ahead of it, or the level of a play (p)."""
        z, sensor = self.plant.output(self.p.plant, s.plant), self.p.sensor
        if sensor.gap_right.numel():
            return held(ca, z, s.sensor, sensor.gap_right, sensor.gap_left)
        return z + w.before

    def levels(self, w: Exogenous) -> Levels:
        """Levels of z, noise ahead of the zone included (p each).

        The side is right where z lies above the first upper one, left where z lies below the first
        lower one; beyond the second ones the reading is at a limit of its range.
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
        """d_r, d_l at an instant (p each)."""
        return self.p.sensor.right * (1 + w.right), self.p.sensor.left * (1 + w.left)

    def exogenous(self, instant: Exogenous, column: ca.SX) -> Exogenous:
        """The exogenous inputs of one instant, scaled.

        A missing reading is noise that is not a number; its side is silent.

        Args:
            instant: the shapes of the exogenous inputs.
            column: their numbers, unscaled, one below the other.
        """
        w: Exogenous = tree.unpack(instant, column)
        scale = self.p.scale
        scaled = Target(*(part * scale.reference for part in w.target[:3]))
        return w._replace(
            target=scaled._replace(plan=w.target.plan),
            w=w.w * scale.disturbance,
            before=w.before * scale.before,
            after=w.after * scale.after + w.lost,
        )

    def move(self, s: State, w: Exogenous, mode: Mode) -> tuple[State, Outputs]:
        """The state's derivative (or next value) and the outputs, on a given branch."""
        z = self.plant.output(self.p.plant, s.plant)
        level = s.sensor
        if self.kind == "play":
            level = held(ca, z, s.sensor, *self.widths(w))
            mode = Mode(mode.zone, contact(level, s.sensor))
        elif self.p.sensor.gap_right.numel():
            level = self.ahead_of_zone(s, w)
        reading = self._read(self.ahead_of_zone(s, w), level, s, w, mode)
        unused = ca.SX.sym("unused", self.plant.m)  # an estimate does not depend on u
        observer, estimate = self.observer.step(self.p.observer, s.observer, unused, reading)
        controller, u = self.controller.step(self.p.controller, s.controller, estimate, w.target)
        compensator = s.compensator
        if self.compensator is not None:
            parts = self.p.compensator, s.compensator, u, estimate, reading
            compensator, u = self.compensator.step(*parts)
        if self.plant.limit is not None:
            u = ca.fmax(ca.fmin(u, self.plant.limit), -self.plant.limit)
        actuator, entering = self._actuated(s, u)
        if self.p.sensor.friction.numel():  # of the load, while it is pushed
            entering = entering - self.p.sensor.friction * contact(level, s.sensor)
        observer = tree.substituted(observer, unused, u)
        plant = self.plant.move(self.p.plant, s.plant, entering + w.w)
        outputs = Outputs(s.plant, z, reading.y, reading.side, u, estimate)
        return State(plant, observer, controller, level, compensator, actuator), outputs

    def _actuated(self, s: State, u: ca.SX) -> tuple[Any, ca.SX]:
        """(the command within its rate, what enters the plant) of a command u (m)."""
        drive = self.p.actuator
        if drive is None:
            return s.actuator, u
        passed, last = within_limits(ca, u, drive), s.actuator
        if last.shape[0]:
            passed = within_rate(ca, passed, last, drive, self.p.h)
            last = passed
        return last, through_zone(ca, passed, drive)

    def _read(self, z: ca.SX, level: ca.SX, s: State, w: Exogenous, mode: Mode) -> Reading:
        """What the sensor gives of `ahead_of_zone` (p) on a given branch; level: of a play."""
        sensor = self.p.sensor
        if self.kind == "play":
            y = sensor.slope * level + w.after
            if sensor.quantum.numel():
                y = quantised(y, sensor.quantum)
            y = self._within_range(y)
            if sensor.limits is None:
                return Reading(y, mode.side, s.plant)
            end = at_limit(y, sensor.limits)
            return Reading(y, ca.if_else(end != 0, 2 * end, mode.side), s.plant)
        exact = branch(z, mode.zone, *self.widths(w), sensor.slope, self.kind)
        y = exact + w.after
        if sensor.quantum.numel():
            y = self._within_range(quantised(y, sensor.quantum))
            return Reading(y, side(y, sensor.threshold, sensor.limits), s.plant)
        if sensor.limits is None:
            return Reading(y, mode.side, s.plant)
        if self.plant.Ts is None:
            y = ca.if_else(mode.side > 1, sensor.limits.high, y)
            y = ca.if_else(mode.side < -1, sensor.limits.low, y)
            return Reading(y, mode.side, s.plant)
        y = self._within_range(y)
        active = ca.fmax(ca.fmin(mode.side, 1.0), -1.0)
        return Reading(y, active + at_limit(y, sensor.limits), s.plant)

    def _within_range(self, y: ca.SX) -> ca.SX:
        """A reading kept within its range, if it has one; a missing one stays missing."""
        limits = self.p.sensor.limits
        if limits is None:
            return y
        y = ca.if_else(y > limits.high, limits.high, y)
        return ca.if_else(y < limits.low, limits.low, y)

    def admissible(self, like: State, column: ca.SX) -> ca.SX:
        """The admissible state nearest to a column, as a column.

        Args:
            like: a state of the right shapes.
            column: the numbers of a state.
        """
        s: State = tree.unpack(like, column)
        return tree.stack(s._replace(observer=self.observer.project(self.p.observer, s.observer)))
