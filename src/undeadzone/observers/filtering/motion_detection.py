"""Detection of the branch of a backlash from the motion of its readings (docs/play.md).

Three rules, by the properties of the sensor:

* exact readings: the sign of their change,
* an encoder, which has a quantum and no noise: a tick shows the side without error, and is taken
  for z at its time,
* noisy readings: the slope of those before, by a fading line, beyond what noise makes of it, if the
  observer's own z^ moves the same way.
"""

from __future__ import annotations

from functools import partial
from itertools import starmap
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import (
    Estimate,
    Observer,
    Reading,
    drop_limit_readings,
    wrap_observer,
)
from undeadzone.nonlinearities.play import detect_tick
from undeadzone.nonlinearities.sensor import Zone, present, side
from undeadzone.plants.system import System
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

FEWEST = 1e-6  # of known^3 - known, which is 0 for one reading: its line has no slope
ROUNDING = 1e-12  # share of a reading by which it may change without motion
# Methods that form their innovation on a side and use censored samples as bounds or not at all.
BRANCH_OBSERVERS = (
    "adaptive_inverse",
    "auto",
    "censored",
    "certified",
    "full_state",
    "kalman",
    "luenberger",
    "oracle",
)
# Of a play ahead of a dead zone; the latter two take no widths into account.
BACKLASH_AHEAD_OBSERVERS = ("auto", "censored", "kalman", "full_state", "luenberger")
ONE_EDGE_OBSERVERS = ("auto", "censored", "extended", "kalman")


class Motion(NamedTuple):
    """Parameters of the rules, the last field of the observer's parameters.

    Attributes:
        slope: m (p) [y/z].
        quantum: of the readings (p) [y].
        threshold: change over the window that counts as motion (p) [y].
        window: number of readings that the fading line stands for (1).
        gains: of the fading line, on level and slope (2).
        friction: of the load behind the play (p) [u] (empty if absent).
    """

    slope: Floats
    quantum: Floats
    threshold: Floats
    window: Any
    gains: Floats
    friction: Floats


class State(NamedTuple):
    """State of the observer, and of the motion detection.

    Attributes:
        observer: the observer's.
        level, slope: of the fading line through the readings, and its rise in a step (p) [y] (of
            exact readings the last one, and 0).
        known: how many readings the level rests on, at most `window` (p).
        ahead: by how much z^ moves until the next reading (p) [z].
        refused: readings that the observer had refused so far (p).
    """

    observer: Any
    level: Any
    slope: Any
    known: Any
    ahead: Any
    refused: Any


def add_motion_detection(observer: Observer, model: System, sensor: Zone) -> Observer:
    """Return the observer with branch detection for a backlash.

    For a further kind of sensor return the observer itself.

    Args:
        observer: that takes side, level and rms of a reading as given.
        model: the sampled model.
        sensor: the sensor.

    Raises:
        InputError: in continuous time.
    """
    if not sensor.moves:
        return observer
    if model.Ts is None:
        raise InputError(
            "sensor.kind: the side of a play is made out from one reading to the next. Set "
            'simulation.time = "sampled"'
        )
    fade = line_fading(sensor.window)
    numbers = Motion(
        slope=sensor.slope,
        quantum=sensor.quantum,
        threshold=sensor.threshold if sensor.play is None else sensor.play.threshold,
        window=np.float64(sensor.window),
        gains=np.array([1 - fade**2, (1 - fade) ** 2]),
        friction=sensor.friction if sensor.friction.any() else np.empty(0),
    )
    none = np.zeros(model.p)
    step = partial(step_with_motion, observer, model, sensor)
    return wrap_observer(
        observer, "motion", numbers, lambda own: State(own, none, none, none, none, none), step
    )


def line_fading(window: int) -> float:
    """Return the share of a residual that a fading line keeps per step [1].

    Its slope has the variance of that of a straight line through `window` readings: 2 ((1 - b) /
    (1 + b))^3 = 12 / window^3 for large windows.
    """
    ratio = 6 ** (1 / 3) / window
    return (1 - ratio) / (1 + ratio)


def step_with_motion(
    observer: Observer, model: System, sensor: Zone, q: Any, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the next state and the estimate, with detected branches.

    Here q: the observer's parameters, then `Motion`.
    """
    inner = tree.drop_last_field(q, type(observer.params))
    motion = q.motion
    reading = drop_limit_readings(reading, sensor.limits)
    y = reading.y
    seen = present(y)
    moving, edge, rms = detect_branches(sensor, motion, s, y)
    moving = ca.if_else(seen, moving, 0.0)
    if sensor.play is None:
        motion_reading = Reading(edge, moving, reading.x, edge, rms)
    else:
        motion_reading = Reading(edge, reading.side, reading.x, rms=rms, motion=moving)
    if motion.friction.numel():
        u = u - motion.friction * motion_reading.side
    moved, estimate = observer.step(inner, s.observer, u, motion_reading)
    ahead = model.output(inner.model, model.move(inner.model, estimate.x, u)) - estimate.z
    refused = s.refused
    regular = seen
    if estimate.refused.shape[0]:
        refused = estimate.refused
        regular = ca.logic_and(seen, refused == s.refused)
    line = update_line(sensor, motion, s, y, regular)
    after = State(moved, *line, ahead, refused)
    if sensor.play is not None:
        return after, estimate
    return after, estimate._replace(contact=motion_reading.side)


def detect_branches(sensor: Zone, q: Motion, s: State, y: Any) -> tuple[Any, Any, Any]:
    """Return (branches (p), readings on the branch (p) [y], their rms errors (p) [y])."""
    parts = []
    for i in range(sensor.slope.size):
        rule = branch_by_line
        if not sensor.noise[i]:
            rule = branch_by_tick if sensor.quantum[i] else branch_by_change
        parts.append(rule(q, s, y, i))
    moving, edge, rms = starmap(ca.vertcat, zip(*parts, strict=True))
    return ca.if_else(s.known, moving, 0.0), edge, rms


def branch_by_change(q: Motion, s: State, y: Any, i: int) -> tuple[Any, Any, Any]:
    """Return branch, reading and rms error of output i by the sign of its change."""
    change = y[i] - s.level[i]
    least = ROUNDING * (ca.fabs(y[i]) + ca.fabs(s.level[i]))
    return side(change, least), y[i], 0.0


def branch_by_tick(q: Motion, s: State, y: Any, i: int) -> tuple[Any, Any, Any]:
    """Return branch, reading and rms error of output i by its ticks.

    The reading lies beyond a boundary by at most z^'s motion in a step.
    """
    quantum = q.quantum[i]
    tick = side(y[i] - s.level[i], quantum / 2)
    at_boundary, variance = detect_tick(ca, y[i], tick, s.ahead[i] * q.slope[i], quantum)
    return tick, at_boundary, ca.if_else(tick != 0, ca.sqrt(variance), quantum / np.sqrt(12))


def branch_by_line(q: Motion, s: State, y: Any, i: int) -> tuple[Any, Any, Any]:
    """Return branch, reading and rms error of output i by the slope of earlier readings.

    The branch counts only if z^ moves the same way.

    The variance of a slope through few readings is larger, by window^3 / (known^3 - known).
    """
    few = ca.fmax(s.known[i] ** 3 - s.known[i], FEWEST)
    uncertain = ca.fmax(q.window**3 / few, 1.0)
    moving = side(s.slope[i] * q.window, q.threshold[i] * ca.sqrt(uncertain))
    return ca.if_else(moving * s.ahead[i] > 0, moving, 0.0), y[i], 0.0


def update_line(sensor: Zone, q: Motion, s: State, y: Any, regular: Any) -> tuple[Any, Any, Any]:
    """Return (level, slope, known) of the readings so far (p each).

    The line restarts if none was known.

    The line through the first readings is the straight one, until the fading one forgets faster. It
    is extrapolated if a noisy reading is missing or was rejected, and is based on one reading less.
    Other missing readings contain no information on the motion after them.
    """
    expected = s.level + s.slope
    residual = y - expected
    noisy = sensor.noise > 0
    one = s.known + 1
    two = s.known + 2
    at_level = ca.fmax(q.gains[0], 2 * (2 * s.known + 1) / (one * two))
    at_slope = ca.fmax(q.gains[1], 6 / (one * two))
    level = ca.if_else(noisy, expected + at_level * residual, y)
    slope = ca.if_else(noisy, s.slope + at_slope * residual, 0.0)
    level = ca.if_else(s.known, level, y)
    slope = ca.if_else(s.known, slope, 0.0)
    lasting = noisy * ca.fmax(s.known - 1, 0.0)
    return (
        ca.if_else(regular, level, noisy * expected),
        ca.if_else(regular, slope, noisy * s.slope),
        ca.if_else(regular, ca.fmin(s.known + 1, q.window), lasting),
    )


def require_branch_observer(options: Any, sensor: Zone) -> None:
    """Raise InputError if the method does not support the sensor's backlash, or its one edge."""
    method = str(options.__struct_config__.tag)
    ahead = "knows no play ahead of a dead zone"
    moved = "takes the reading for a function of z, which a play is not"
    two = "needs two edges, and a width of inf takes one away"
    rows = (
        (sensor.play is not None, BACKLASH_AHEAD_OBSERVERS, ahead, ", or leave out sensor.play"),
        (sensor.kind == "play", BRANCH_OBSERVERS, moved, ""),
        (sensor.absent.any(), ONE_EDGE_OBSERVERS, two, ""),
    )
    for has_it, methods, why, instead in rows:
        if has_it and method not in methods:
            use = ", ".join(methods)
            raise InputError(f"observer.method: {method!r} {why}. Use one of {use}{instead}")
