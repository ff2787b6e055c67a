"""The interval observer: boxes that hold the state and the widths, whatever bounded noise and disturbance do."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, estimate
from undeadzone.linear.scaling import sizes
from undeadzone.observers.parts.boxes import FAR, Bounds, Boxes, cut, each, meet
from undeadzone.observers.parts.gain import injection
from undeadzone.observers.parts.measured_kalman import FLOOR, declared
from undeadzone.observers.parts.modal_form import Modes, modes, turned
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole
from undeadzone.sensor import Zone, present
from undeadzone.support.arrays import Array, Floats, nonnegative, scalar

NOISE = 6.0  # bound that is assumed of a Gaussian noise, in rms


class Interval(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="interval",
):
    """Gouze, Rapaport and Hadj-Sadok (2000); Mazenc and Bernard (2011): guaranteed bounds; their midpoints are the estimates.

    Declared bounds: right, left: ranges [lo, hi] of d_r and d_l [z], one or one per output (left: default that of right);
    noise [y], noise_before [z]: one or one per output (default: six times the sensor's rms); disturbance: of the
    input disturbance [u], one or one per input; x_max: of |x(0)|, one or one per state (default: five times the
    largest width). L, poles [1/s] or speed [1/s] of A - L C (default: L = 0 for a stable plant, else a speed of twice the fastest pole).
    contraction [1/s]: in continuous time, how fast bounds follow what a reading tells (default: ten times the fastest pole). Where declared
    bounds contradict each other the boxes start anew. x_std, ... are half the intervals' widths / sqrt(3), std of a uniform distribution.
    """

    right: Array
    left: Array | None = None
    noise: Array | None = None
    noise_before: Array | None = None
    disturbance: Array = 0.0
    x_max: Array | None = None
    L: Array | None = None
    poles: Array | None = None
    speed: float | None = None
    contraction: float | None = None

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer for a linear model, continuous or sampled. Raises InputError, ShapeError, StructureError."""
        if model.nonlinear:
            raise InputError(
                "observer.method: 'interval' bounds linear plants only; use 'censored' for a nonlinear one"
            )
        n, p = model.n, model.p
        ranges: Floats = declared(self.right, self.left, p)
        after = (
            NOISE * sensor.noise
            if self.noise is None
            else nonnegative("observer.noise", self.noise, p, "one per output")
        )
        before = (
            NOISE * sensor.noise_before
            if self.noise_before is None
            else nonnegative("observer.noise_before", self.noise_before, p, "one per output")
        )
        disturbance = nonnegative(
            "observer.disturbance", self.disturbance, model.m, "one per input"
        )
        x_max = 5 * ranges.max() if self.x_max is None else self.x_max
        start = nonnegative("observer.x_max", x_max, n, "one per state")
        flow = model.linear if model.flow is None else model.flow
        if self.L is self.poles is self.speed is None and np.linalg.eigvals(
            flow.A
        ).real.max() < -1e-9 * np.linalg.norm(flow.A, 2):
            L: Floats = np.zeros((n, p))
        else:
            L = injection(model, self.L, self.poles, self.speed, 2.0)
        if model.Ts is not None:
            pace = 1.0
        elif self.contraction is None:
            pace = 10 * fastest_pole(model)
        else:
            pace = scalar("observer.contraction", self.contraction, least=0.0)
        seen = modes(model.linear.A - L @ model.linear.C, 1 / sizes(flow.A.T, flow.C.T), model.Ts)
        noise = (
            after / sensor.slope + before + FLOOR * np.ptp(ranges, axis=1).reshape(2, p).max(axis=0)
        )
        sure = np.where(after > sensor.threshold, after, -FAR)
        slack = np.maximum(after, sensor.threshold) / sensor.slope + noise
        params = Params(
            model.params, L, sensor.slope, seen.T, seen.inverse, seen.S, seen.turn, np.float64(pace), disturbance, noise, sure, slack,
            Boxes(np.zeros(n), np.abs(seen.inverse) @ start, Bounds(*ranges[:p].T), Bounds(*ranges[p:].T)),
        )  # fmt: skip
        return interval(model, seen, params, sensor.kind)


class Params(NamedTuple):
    """Numbers of the observer; L per step when sampled; T, inverse, S, turn of `Modes`; pace of contraction (1 when sampled).

    disturbance (m): its bound. In units of z (p): noise: of a reading on a sure side; sure: |y| [y] above which a side is;
    slack: how far z may be beyond an edge that is silent, or not surely active. start: the boxes at first.
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


def interval(model: System, seen: Modes, params: Params, kind: str) -> Observer:
    """The observer. Each step: what the box says of z, z of the widths, they and the reading of z, and that of the box."""
    n, p, sampled = model.n, model.p, model.Ts is not None
    coupling = np.triu(np.ones((n, n)), 1)
    coupling[seen.pairs, np.array(seen.pairs, int) + 1] = 0.0

    def project(q: Params, s: State) -> State:
        """Boxes that are empty start anew around x^."""
        edges = (s.boxes.right, s.boxes.left)
        empty = ca.mmin(ca.vertcat(s.boxes.radius, *(edge.hi - edge.lo for edge in edges))) < 0
        fresh = q.start._replace(x=s.boxes.x)
        return s._replace(boxes=each(lambda new, old: ca.if_else(empty, new, old), fresh, s.boxes))

    def hull(q: Params, boxes: Boxes, frame: Any) -> Bounds:
        z, spread = q.model.C @ boxes.x, ca.fabs(q.model.C @ frame) @ boxes.radius
        return Bounds(z - spread, z + spread)

    def tightened(q: Params, boxes: Boxes, frame: Any, reading: Reading) -> tuple[Boxes, Bounds]:
        """(the boxes given a reading, bounds of z)."""
        y = reading.y / q.slope
        on_right, on_left = (
            ca.logic_and(reading.side > 0, reading.y > q.sure),
            ca.logic_and(reading.side < 0, -reading.y > q.sure),
        )
        active = ca.logic_or(on_right, on_left)
        silent = ca.logic_and(present(reading.y), ca.logic_not(active))

        def at_most(where: Any, bound: Any) -> Any:
            return ca.if_else(where, bound, FAR)

        z = hull(q, boxes, frame)
        if kind == "jump":
            upper, lower, off = (y, -y), (FAR, FAR), Bounds(0.0, 0.0)
        else:
            upper, lower = (z.hi - y, y - z.lo), (y - z.lo, z.hi - y)
        right = Bounds(-at_most(silent, q.slack - z.lo), at_most(on_right, upper[0] + q.noise))
        left = Bounds(-at_most(silent, q.slack + z.hi), at_most(on_left, upper[1] + q.noise))
        right = meet(meet(boxes.right, right), Bounds(-at_most(on_right, lower[0] + q.noise), FAR))
        left = meet(meet(boxes.left, left), Bounds(-at_most(on_left, lower[1] + q.noise), FAR))
        if kind != "jump":  # what the sensor takes off z
            off = Bounds(
                ca.if_else(on_right, right.lo, -left.hi), ca.if_else(on_right, right.hi, -left.lo)
            )
        told = Bounds(
            ca.if_else(active, y + off.lo - q.noise, -at_most(silent, left.hi + q.slack)),
            ca.if_else(active, y + off.hi + q.noise, at_most(silent, right.hi + q.slack)),
        )
        x, radius = boxes.x, boxes.radius
        for i in range(p):
            x, radius = cut(x, radius, frame, q.model.C[i, :], told.lo[i], told.hi[i])
        found = Boxes(x, radius, right, left)
        return found, meet(hull(q, found, frame), told)

    def step(q: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        phi = turned(seen.pairs, n, s.angle)
        frame = q.T @ phi
        now, z = tightened(q, s.boxes, frame, reading)
        shown = project(q, State(now, s.angle)).boxes
        boxes = shown if sampled else s.boxes
        e = (z.lo + z.hi) / 2 - q.model.C @ boxes.x
        x = model.move(q.model, boxes.x, u) + q.L @ e
        ahead = turned(seen.pairs, n, s.angle + q.turn) if sampled else phi
        spread = (
            ca.fabs(ahead.T @ q.inverse @ q.model.B) @ q.disturbance
            + ca.fabs(ahead.T @ q.inverse @ q.L) @ (z.hi - z.lo) / 2
        )
        if sampled:
            radius = ca.fabs(ahead.T @ q.S @ phi) @ boxes.radius + spread
            after = State(boxes._replace(x=x, radius=radius), s.angle + q.turn)
        else:
            radius = (
                ca.fabs(ahead.T @ (coupling * q.S) @ phi) @ boxes.radius
                + ca.diag(q.S) * boxes.radius
                + spread
            )
            rate = Boxes(x, radius, Bounds(0.0, 0.0), Bounds(0.0, 0.0))
            after = State(
                each(lambda rate, new, old: rate + q.pace * (new - old), rate, now, boxes), q.turn
            )
        return after, _read(q, shown, frame, reading, kind, e)

    def init(q: Params) -> State:
        return State(q.start, np.zeros(len(seen.pairs)))

    return Observer(params, init, step, project, Traits(L=params.L))


def _read(q: Params, boxes: Boxes, frame: Any, reading: Reading, kind: str, e: Any) -> Estimate:
    """Midpoints, and half-widths / sqrt(3)."""
    right, left = ((edge.lo + edge.hi) / 2 for edge in (boxes.right, boxes.left))
    half = [(edge.hi - edge.lo) / 2 for edge in (boxes.right, boxes.left)]
    x_std, right_std, left_std, width_std = (
        size / math.sqrt(3) for size in (ca.fabs(frame) @ boxes.radius, *half, half[0] + half[1])
    )
    found = estimate(boxes.x, q.model.C @ boxes.x, right, left, reading, q.slope, kind, e)
    return found._replace(x_std=x_std, right_std=right_std, left_std=left_std, width_std=width_std)
