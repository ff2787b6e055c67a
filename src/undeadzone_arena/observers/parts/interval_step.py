"""Interval observer as pure functions of its boxes.

Each step bounds z by the box, the widths by z, z by the widths and the reading, and the box by z.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading, Traits, build_estimate
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats
from undeadzone_arena.observers.parts.boxes import (
    FAR,
    Bounds,
    Boxes,
    cut_box,
    intersect_bounds,
    map_boxes,
)
from undeadzone_arena.observers.parts.modal_form import mode_rotation


class IntervalParams(NamedTuple):
    """Numbers of the observer.

    Attributes:
        model: numbers of the model.
        L: gain (n x p), per step when the model is sampled.
        slope: slope m of the sensor (p).
        T, inverse, S, turn: of `Modes`.
        pace: rate at which bounds follow a reading [1/s] (1 when sampled).
        disturbance: bound of the input disturbance (m) [u].
        noise: bound of the noise of a reading on a sure side (p) [z].
        sure: |y| above which a side is sure (p) [y].
        slack: how far z may be beyond an edge that is silent, or not surely active (p) [z].
        start: the boxes at first.
    """

    model: Any
    L: Floats
    slope: Floats
    T: Floats
    inverse: Floats
    S: Floats
    turn: Floats
    pace: Any
    disturbance: Floats
    noise: Floats
    sure: Floats
    slack: Floats
    start: Boxes


class IntervalState(NamedTuple):
    """State: the boxes, and the angles of the oscillating modes."""

    boxes: Boxes
    angle: Any


class IntervalSetup(NamedTuple):
    """Fixed parts of one observer.

    Attributes:
        model: the model.
        pairs: first rows of its oscillating modes.
        kind: kind of the sensor.
        ends: whether its readings have a range.
    """

    model: System
    pairs: list[int]
    kind: str
    ends: bool

    @property
    def is_jump(self) -> bool:
        """Return whether the sensor is of the jump kind."""
        return self.kind == "jump"


class SureSides(NamedTuple):
    """Certain conclusions from a reading about each output (p).

    Attributes:
        right, left: z is beyond that edge, by the reading or more.
        active: either of both.
        silent: z is beyond no edge.
        exact_right, exact_left: z is beyond the edge by exactly the reading, and not by more as at
            a limit of the range.
    """

    right: Any
    left: Any
    active: Any
    silent: Any
    exact_right: Any
    exact_left: Any


def build_interval_observer(
    model: System, pairs: list[int], params: IntervalParams, sensor: Zone
) -> Observer:
    """Build the observer.

    Args:
        model: the linear model, continuous or sampled.
        pairs: first rows of its oscillating modes.
        params: its numbers.
        sensor: the dead zone, for its kind and its range.
    """
    setup = IntervalSetup(model, pairs, sensor.kind, sensor.limits is not None)

    def init(q: IntervalParams) -> IntervalState:
        """Return the boxes at t = 0."""
        return IntervalState(q.start, np.zeros(len(pairs)))

    step = partial(interval_step, setup)
    return Observer(params, init, step, restart_empty_boxes, Traits(L=params.L))


def restart_empty_boxes(q: IntervalParams, s: IntervalState) -> IntervalState:
    """Return the state, with all boxes restarted around x^ if any is empty."""
    widths = [edge.hi - edge.lo for edge in (s.boxes.right, s.boxes.left)]
    empty = ca.mmin(ca.vertcat(s.boxes.radius, *widths)) < 0
    fresh = q.start._replace(x=s.boxes.x)
    return s._replace(boxes=map_boxes(lambda new, old: ca.if_else(empty, new, old), fresh, s.boxes))


def interval_step(
    setup: IntervalSetup, q: IntervalParams, s: IntervalState, u: Any, reading: Reading
) -> tuple[IntervalState, Estimate]:
    """Return the state's derivative, or its next value when sampled, and the estimate."""
    sampled = setup.model.Ts is not None
    phi = mode_rotation(setup.pairs, setup.model.n, s.angle)
    frame = q.T @ phi
    now, z = tighten_boxes(setup, q, s.boxes, frame, reading)
    restarted_boxes = restart_empty_boxes(q, IntervalState(now, s.angle)).boxes
    boxes = restarted_boxes if sampled else s.boxes
    e = (z.lo + z.hi) / 2 - q.model.C @ boxes.x
    x = setup.model.move_with_correction(q.model, boxes.x, u, q.L @ e)
    if sampled:
        after = next_boxes(setup, q, boxes._replace(x=x), phi, s.angle + q.turn, z)
    else:
        rate = boxes_rate(setup, q, boxes._replace(x=x), phi, z)
        followed = map_boxes(lambda rate, new, old: rate + q.pace * (new - old), rate, now, boxes)
        after = IntervalState(followed, q.turn)
    return after, boxes_to_estimate(q, restarted_boxes, frame, reading, setup.kind, e)


def next_boxes(
    setup: IntervalSetup, q: IntervalParams, boxes: Boxes, phi: Any, angle: Any, z: Bounds
) -> IntervalState:
    """Return the state at the next sample.

    Args:
        setup: the observer.
        q: its numbers.
        boxes: the boxes now, with the midpoint x^ at the next sample.
        phi: Phi of the angles now.
        angle: the angles at the next sample.
        z: bounds of z.
    """
    ahead = mode_rotation(setup.pairs, setup.model.n, angle)
    spread = radius_increase(q, ahead, z)
    radius = ca.fabs(ahead.T @ q.S @ phi) @ boxes.radius + spread
    return IntervalState(boxes._replace(radius=radius), angle)


def boxes_rate(setup: IntervalSetup, q: IntervalParams, boxes: Boxes, phi: Any, z: Bounds) -> Boxes:
    """Return the rate of the boxes by the motion, per second.

    Args:
        setup: the observer.
        q: its numbers.
        boxes: the boxes now, with x^' for their midpoint.
        phi: Phi of the angles now.
        z: bounds of z.
    """
    between = coupling_mask(setup.pairs, setup.model.n) * q.S
    spread = radius_increase(q, phi, z)
    grown = ca.fabs(phi.T @ between @ phi) @ boxes.radius
    radius = grown + ca.diag(q.S) * boxes.radius + spread
    return Boxes(boxes.x, radius, Bounds(0.0, 0.0), Bounds(0.0, 0.0))


def coupling_mask(pairs: list[int], n: int) -> Floats:
    """Return 1 at the entries of S that couple two modes (n x n), above its blocks."""
    mask = np.triu(np.ones((n, n)), 1)
    mask[pairs, np.array(pairs, int) + 1] = 0.0
    return mask


def radius_increase(q: IntervalParams, phi: Any, z: Bounds) -> Any:
    """Return the increase of the half-widths by disturbance and uncertainty of z (n)."""
    by_disturbance = ca.fabs(phi.T @ q.inverse @ q.model.B) @ q.disturbance
    return by_disturbance + ca.fabs(phi.T @ q.inverse @ q.L) @ (z.hi - z.lo) / 2


def output_bounds(q: IntervalParams, boxes: Boxes, frame: Any) -> Bounds:
    """Return the bounds of z = C x from the box of x (p) [z]."""
    z = q.model.C @ boxes.x
    spread = ca.fabs(q.model.C @ frame) @ boxes.radius
    return Bounds(z - spread, z + spread)


def sure_sides(setup: IntervalSetup, q: IntervalParams, reading: Reading) -> SureSides:
    """Return the certain conclusions from a reading about each output."""
    right = ca.logic_and(reading.side > 0, reading.y > q.sure)
    left = ca.logic_and(reading.side < 0, -reading.y > q.sure)
    active = ca.logic_or(right, left)
    silent = ca.logic_and(present(reading.y), ca.logic_not(active))
    if not setup.ends:
        return SureSides(right, left, active, silent, right, left)
    exact = ca.fabs(reading.side) < 2
    exact_right = ca.logic_and(right, exact)
    exact_left = ca.logic_and(left, exact)
    return SureSides(right, left, active, silent, exact_right, exact_left)


def tighten_boxes(
    setup: IntervalSetup, q: IntervalParams, boxes: Boxes, frame: Any, reading: Reading
) -> tuple[Boxes, Bounds]:
    """Return the boxes given a reading, and the bounds of z."""
    y = reading.y / q.slope
    on = sure_sides(setup, q, reading)
    right, left = width_bounds(setup, q, boxes, output_bounds(q, boxes, frame), y, on)
    bounds = reading_bounds(setup, q, right, left, y, on)
    x = boxes.x
    radius = boxes.radius
    for i in range(setup.model.p):
        x, radius = cut_box(x, radius, frame, q.model.C[i, :], bounds.lo[i], bounds.hi[i])
    inside = Boxes(x, radius, right, left)
    return inside, intersect_bounds(output_bounds(q, inside, frame), bounds)


def width_bounds(
    setup: IntervalSetup, q: IntervalParams, boxes: Boxes, z: Bounds, y: Any, on: SureSides
) -> tuple[Bounds, Bounds]:
    """Return the bounds of d_r and d_l given those of z and a reading (p each) [z].

    Args:
        setup: the observer.
        q: its numbers.
        boxes: the bounds before.
        z: bounds of z.
        y: reading y / m (p).
        on: certain conclusions from the reading.
    """
    mirrored = Bounds(-z.hi, -z.lo)
    return (
        right_bounds(setup, q, boxes.right, z, y, on.silent, on.right, on.exact_right),
        right_bounds(setup, q, boxes.left, mirrored, -y, on.silent, on.left, on.exact_left),
    )


def right_bounds(
    setup: IntervalSetup,
    q: IntervalParams,
    before: Bounds,
    z: Bounds,
    y: Any,
    silent: Any,
    beyond: Any,
    exact: Any,
) -> Bounds:
    """Return the bounds of d_r given those of z and a reading (p) [z]; of -z and -y, of d_l.

    Args:
        setup: the observer.
        q: its numbers.
        before: the bounds before.
        z: bounds of z.
        y: reading y / m (p).
        silent, beyond, exact: certain conclusions from the reading about the edge.
    """
    if setup.is_jump:  # a reading is z itself, beyond d_r
        most, least, met = y, FAR, exact
    else:  # a reading is z - d_r
        most, least, met = z.hi - y, y - z.lo, beyond
    bounds = Bounds(
        -conditional_bound(silent, q.slack - z.lo), conditional_bound(met, most + q.noise)
    )
    again = Bounds(-conditional_bound(exact, least + q.noise), FAR)
    return intersect_bounds(intersect_bounds(before, bounds), again)


def reading_bounds(
    setup: IntervalSetup, q: IntervalParams, right: Bounds, left: Bounds, y: Any, on: SureSides
) -> Bounds:
    """Return the bounds of z given those of the widths and a reading (p) [z]."""
    if setup.is_jump:
        off = Bounds(0.0, 0.0)
    else:  # offset that the sensor subtracts from z
        least = ca.if_else(on.right, right.lo, -left.hi)
        most = ca.if_else(on.right, right.hi, -left.lo)
        off = Bounds(least, most)
    bounds = Bounds(
        ca.if_else(
            on.active, y + off.lo - q.noise, -conditional_bound(on.silent, left.hi + q.slack)
        ),
        ca.if_else(
            on.active, y + off.hi + q.noise, conditional_bound(on.silent, right.hi + q.slack)
        ),
    )
    if not setup.ends:
        return bounds
    past_right = ca.logic_and(on.right, ca.logic_not(on.exact_right))
    past_left = ca.logic_and(on.left, ca.logic_not(on.exact_left))
    return Bounds(ca.if_else(past_left, -FAR, bounds.lo), ca.if_else(past_right, FAR, bounds.hi))


def conditional_bound(holds: Any, bound: Any) -> Any:
    """Return a bound if a condition is true, else an infinite bound."""
    return ca.if_else(holds, bound, FAR)


def boxes_to_estimate(
    q: IntervalParams, boxes: Boxes, frame: Any, reading: Reading, kind: str, e: Any
) -> Estimate:
    """Convert boxes to an estimate: midpoints, and half-widths / sqrt(3)."""
    right = boxes.right
    left = boxes.left
    half_right = (right.hi - right.lo) / 2
    half_left = (left.hi - left.lo) / 2
    midpoints = build_estimate(
        boxes.x,
        q.model.C @ boxes.x,
        (right.lo + right.hi) / 2,
        (left.lo + left.hi) / 2,
        reading,
        q.slope,
        kind,
        e,
    )
    return midpoints._replace(
        x_std=ca.fabs(frame) @ boxes.radius / math.sqrt(3),
        right_std=half_right / math.sqrt(3),
        left_std=half_left / math.sqrt(3),
        width_std=(half_right + half_left) / math.sqrt(3),
    )
