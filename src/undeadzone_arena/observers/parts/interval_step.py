"""The interval observer as pure functions of its boxes.

Each step follows what the box says of z, what z says of the widths, what they and the reading say
of z, and what that says of the box.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Estimate, Observer, Reading, Traits, estimate
from undeadzone.nonlinearities.sensor import Zone, present
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats
from undeadzone_arena.observers.parts.boxes import FAR, Bounds, Boxes, cut, each, meet
from undeadzone_arena.observers.parts.modal_form import turned


class Params(NamedTuple):
    """Numbers of the observer.

    Attributes:
        model: numbers of the model.
        L: gain (n x p), per step when the model is sampled.
        slope: slope m of the sensor (p).
        T, inverse, S, turn: of `Modes`.
        pace: how fast bounds follow what a reading tells [1/s]; 1 when sampled.
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


class State(NamedTuple):
    """The boxes, and the angles of the oscillating modes."""

    boxes: Boxes
    angle: Any


class Setup(NamedTuple):
    """What the parts of one observer share.

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
    def jump(self) -> bool:
        """Return whether the sensor is of the jump kind."""
        return self.kind == "jump"


class Sides(NamedTuple):
    """What a reading surely says of each output (p).

    Attributes:
        right, left: z is beyond that edge, by what the reading says at least.
        active: either of both.
        silent: z is beyond no edge.
        exact_right, exact_left: z is beyond the edge by what the reading says, not by more, as it
            may be at a limit of the range.
    """

    right: Any
    left: Any
    active: Any
    silent: Any
    exact_right: Any
    exact_left: Any


def interval(model: System, pairs: list[int], params: Params, sensor: Zone) -> Observer:
    """Return the observer.

    Args:
        model: the linear model, continuous or sampled.
        pairs: first rows of its oscillating modes.
        params: its numbers.
        sensor: the dead zone, for its kind and its range.
    """
    setup = Setup(model, pairs, sensor.kind, sensor.limits is not None)

    def init(q: Params) -> State:
        return State(q.start, np.zeros(len(pairs)))

    step = partial(interval_step, setup)
    return Observer(params, init, step, restarted, Traits(L=params.L))


def restarted(q: Params, s: State) -> State:
    """Return boxes that are empty start anew around x^."""
    widths = [edge.hi - edge.lo for edge in (s.boxes.right, s.boxes.left)]
    empty = ca.mmin(ca.vertcat(s.boxes.radius, *widths)) < 0
    fresh = q.start._replace(x=s.boxes.x)
    return s._replace(boxes=each(lambda new, old: ca.if_else(empty, new, old), fresh, s.boxes))


def interval_step(
    setup: Setup, q: Params, s: State, u: Any, reading: Reading
) -> tuple[State, Estimate]:
    """Return the state's derivative, or its next value when sampled, and the estimate."""
    sampled = setup.model.Ts is not None
    phi = turned(setup.pairs, setup.model.n, s.angle)
    frame = q.T @ phi
    now, z = tightened(setup, q, s.boxes, frame, reading)
    shown = restarted(q, State(now, s.angle)).boxes
    boxes = shown if sampled else s.boxes
    e = (z.lo + z.hi) / 2 - q.model.C @ boxes.x
    x = setup.model.move_with_correction(q.model, boxes.x, u, q.L @ e)
    if sampled:
        after = next_boxes(setup, q, boxes._replace(x=x), phi, s.angle + q.turn, z)
    else:
        rate = boxes_rate(setup, q, boxes._replace(x=x), phi, z)
        followed = each(lambda rate, new, old: rate + q.pace * (new - old), rate, now, boxes)
        after = State(followed, q.turn)
    return after, to_estimate(q, shown, frame, reading, setup.kind, e)


def next_boxes(setup: Setup, q: Params, boxes: Boxes, phi: Any, angle: Any, z: Bounds) -> State:
    """Return the state at the next sample.

    Args:
        setup: the observer.
        q: its numbers.
        boxes: the boxes now, with the midpoint x^ at the next sample.
        phi: Phi of the angles now.
        angle: the angles at the next sample.
        z: bounds of z.
    """
    ahead = turned(setup.pairs, setup.model.n, angle)
    spread = added_radius(q, ahead, z)
    radius = ca.fabs(ahead.T @ q.S @ phi) @ boxes.radius + spread
    return State(boxes._replace(radius=radius), angle)


def boxes_rate(setup: Setup, q: Params, boxes: Boxes, phi: Any, z: Bounds) -> Boxes:
    """What the motion adds to the boxes per second.

    Args:
        setup: the observer.
        q: its numbers.
        boxes: the boxes now, with x^' for their midpoint.
        phi: Phi of the angles now.
        z: bounds of z.
    """
    between = coupling(setup.pairs, setup.model.n) * q.S
    spread = added_radius(q, phi, z)
    grown = ca.fabs(phi.T @ between @ phi) @ boxes.radius
    radius = grown + ca.diag(q.S) * boxes.radius + spread
    return Boxes(boxes.x, radius, Bounds(0.0, 0.0), Bounds(0.0, 0.0))


def coupling(pairs: list[int], n: int) -> Floats:
    """Return 1 at the entries of S through which one mode drives another (n x n): above its
    blocks.
    """
    mask = np.triu(np.ones((n, n)), 1)
    mask[pairs, np.array(pairs, int) + 1] = 0.0
    return mask


def added_radius(q: Params, phi: Any, z: Bounds) -> Any:
    """Return the half-widths that disturbance and the uncertainty of z add (n)."""
    by_disturbance = ca.fabs(phi.T @ q.inverse @ q.model.B) @ q.disturbance
    return by_disturbance + ca.fabs(phi.T @ q.inverse @ q.L) @ (z.hi - z.lo) / 2


def output_bounds(q: Params, boxes: Boxes, frame: Any) -> Bounds:
    """Return the bounds of z = C x that the box of x gives."""
    z, spread = q.model.C @ boxes.x, ca.fabs(q.model.C @ frame) @ boxes.radius
    return Bounds(z - spread, z + spread)


def sides(setup: Setup, q: Params, reading: Reading) -> Sides:
    """What a reading surely says of each output."""
    right = ca.logic_and(reading.side > 0, reading.y > q.sure)
    left = ca.logic_and(reading.side < 0, -reading.y > q.sure)
    active = ca.logic_or(right, left)
    silent = ca.logic_and(present(reading.y), ca.logic_not(active))
    if not setup.ends:
        return Sides(right, left, active, silent, right, left)
    exact = ca.fabs(reading.side) < 2
    exact_right, exact_left = ca.logic_and(right, exact), ca.logic_and(left, exact)
    return Sides(right, left, active, silent, exact_right, exact_left)


def tightened(
    setup: Setup, q: Params, boxes: Boxes, frame: Any, reading: Reading
) -> tuple[Boxes, Bounds]:
    """Return (the boxes given a reading, bounds of z)."""
    y = reading.y / q.slope
    on = sides(setup, q, reading)
    right, left = width_bounds(setup, q, boxes, output_bounds(q, boxes, frame), y, on)
    bounds = reading_bounds(setup, q, right, left, y, on)
    x, radius = boxes.x, boxes.radius
    for i in range(setup.model.p):
        x, radius = cut(x, radius, frame, q.model.C[i, :], bounds.lo[i], bounds.hi[i])
    inside = Boxes(x, radius, right, left)
    return inside, meet(output_bounds(q, inside, frame), bounds)


def width_bounds(
    setup: Setup, q: Params, boxes: Boxes, z: Bounds, y: Any, on: Sides
) -> tuple[Bounds, Bounds]:
    """Return the bounds of d_r and d_l given those of z and a reading.

    Args:
        setup: the observer.
        q: its numbers.
        boxes: the bounds before.
        z: bounds of z.
        y: reading y / m (p).
        on: what the reading surely says.
    """
    if setup.jump:  # a reading on the right is z itself, beyond d_r; on the left, beyond -d_l
        most_right, most_left, least_right, least_left = y, -y, FAR, FAR
        met_right, met_left = on.exact_right, on.exact_left
    else:  # a reading is z - d_r on the right, z + d_l on the left
        most_right, most_left = z.hi - y, y - z.lo
        least_right, least_left = y - z.lo, z.hi - y
        met_right, met_left = on.right, on.left
    right = Bounds(-where(on.silent, q.slack - z.lo), where(met_right, most_right + q.noise))
    left = Bounds(-where(on.silent, q.slack + z.hi), where(met_left, most_left + q.noise))
    right_again = Bounds(-where(on.exact_right, least_right + q.noise), FAR)
    left_again = Bounds(-where(on.exact_left, least_left + q.noise), FAR)
    return (
        meet(meet(boxes.right, right), right_again),
        meet(meet(boxes.left, left), left_again),
    )


def reading_bounds(
    setup: Setup, q: Params, right: Bounds, left: Bounds, y: Any, on: Sides
) -> Bounds:
    """Return the bounds of z given those of the widths and a reading."""
    if setup.jump:
        off = Bounds(0.0, 0.0)
    else:  # what the sensor takes off z
        least = ca.if_else(on.right, right.lo, -left.hi)
        most = ca.if_else(on.right, right.hi, -left.lo)
        off = Bounds(least, most)
    bounds = Bounds(
        ca.if_else(on.active, y + off.lo - q.noise, -where(on.silent, left.hi + q.slack)),
        ca.if_else(on.active, y + off.hi + q.noise, where(on.silent, right.hi + q.slack)),
    )
    if not setup.ends:
        return bounds
    past_right = ca.logic_and(on.right, ca.logic_not(on.exact_right))
    past_left = ca.logic_and(on.left, ca.logic_not(on.exact_left))
    return Bounds(ca.if_else(past_left, -FAR, bounds.lo), ca.if_else(past_right, FAR, bounds.hi))


def where(holds: Any, bound: Any) -> Any:
    """Return a bound where something holds, else one that bounds nothing."""
    return ca.if_else(holds, bound, FAR)


def to_estimate(
    q: Params, boxes: Boxes, frame: Any, reading: Reading, kind: str, e: Any
) -> Estimate:
    """Return midpoints, and half-widths / sqrt(3)."""
    right, left = boxes.right, boxes.left
    half_right, half_left = (right.hi - right.lo) / 2, (left.hi - left.lo) / 2
    midpoints = estimate(
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
