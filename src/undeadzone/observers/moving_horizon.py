"""Moving horizon estimation: the likeliest motion over the last samples, edges and ranges as constraints (docs/methods/moving_horizon.md)."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import NumericObserver, Reading, numeric_estimate
from undeadzone.observers.parts import window as horizon
from undeadzone.observers.parts.augmented_state import (
    Assumptions,
    Declared,
    Defaults,
    claims,
    quarter_period,
)
from undeadzone.observers.parts.measured_kalman import sample_time
from undeadzone.observers.parts.window import Weights, Window
from undeadzone.plants.system import System
from undeadzone.sensor import Zone
from undeadzone.support.arrays import Array, Floats, nonnegative, scalar

HABITS = Defaults(noise=0.01, drift=0.005, x_std=5.0)
NODES = 40  # of a horizon, if the period is not given


class MovingHorizon(
    Declared,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="method",
    tag="moving_horizon",
):
    """Moving horizon estimation of [x; d_r; d_l], Rao, Rawlings, Mayne (2003); sampled time.

    right, left, noise, x_std, disturbance, swing, drift: as for `EKF`; the widths stay in their range. horizon: length [s] (default:
    a quarter period of the plant; 1 s if it only integrates). period: time [s] between the readings that are used, and between
    solutions (default: a fortieth of the horizon). slack: rms by which a silent sensor's z may be outside its zone [z], one or one
    per output (default: noise). solver: of CasADi, exact (daqp) or by alternating directions (osqp). It runs in Python: in single runs only.
    """

    horizon: float | None = None
    period: float | None = None
    slack: Array | None = None
    solver: Literal["daqp", "osqp"] = "daqp"

    def build(self, model: System, sensor: Zone) -> NumericObserver:
        """The estimator for a sampled model. Raises InputError, ShapeError."""
        if sensor.kind == "jump":
            raise InputError(
                "observer.method: 'moving_horizon' takes a reading for z - d_r or z + d_l, which that of a jump sensor is not; use 'censored'"
            )
        if not ca.has_conic(self.solver):
            raise InputError(
                f"observer.solver: this CasADi ({ca.__version__}) has no {self.solver!r}; choose another of daqp, osqp"
            )
        Ts = sample_time(model)
        length = (
            quarter_period(model)
            if self.horizon is None
            else scalar("observer.horizon", self.horizon, above=0.0)
        )
        period = (
            length / NODES
            if self.period is None
            else scalar("observer.period", self.period, above=0.0)
        )
        stride = max(1, round(period / Ts))
        nodes = max(1, round(length / (stride * Ts)))
        if nodes > 500:
            raise InputError(
                f"observer.period: expected at most 500 periods in the horizon, found {nodes}"
            )
        given = claims(self, model, sensor, HABITS, stride)
        rms = np.sqrt(given.prior.R)
        slack = (
            rms
            if self.slack is None
            else nonnegative("observer.slack", self.slack, model.p, "one per output")
        )
        if not slack.all():
            raise InputError(
                "observer.slack: must be positive, found 0: noise alone would leave no solution"
            )
        return moving(
            model,
            sensor,
            given,
            Weights(rms, slack, given.prior.gate / sensor.slope, given.ranges),
            nodes,
            stride,
            self.solver,
        )


class State(NamedTuple):
    """The window; X = [x; d_r; d_l] now; its covariance at the newest node; x now = F x + f + G w of that node's x; samples since."""

    window: Window
    X: Floats
    cov: Floats
    F: Floats
    f: Floats
    G: Floats
    since: int


def moving(
    model: System,
    sensor: Zone,
    given: Assumptions,
    weights: Weights,
    nodes: int,
    stride: int,
    plugin: str,
) -> NumericObserver:
    """The estimator over `nodes` intervals of `stride` samples.

    Its covariance, which weighs the past and is shown, is that of a Kalman filter on the active readings: what silence
    adds is not counted.
    """
    n, p, m = model.n, model.p, model.m
    believed = given.prior
    rms = np.sqrt(
        given.variance / stride
    )  # held over a node's samples, it moves the state as far as white noise does
    move, output = _tangents(model)

    def start(seed: int) -> State:
        here = np.eye(n), np.zeros(n), np.zeros((n, m))
        cov = np.diag(believed.std**2)
        C, offset = output(believed.mean[:n])
        padding = Window(
            np.zeros(p), np.zeros(p), np.zeros(p), believed.mean, cov, C, offset, *here
        )
        return State(
            Window(*(np.repeat(part[None], nodes + 1, axis=0) for part in padding)),
            believed.mean,
            cov,
            *here,
            0,
        )

    solve = horizon.solver(plugin, *horizon.size(start(0).window))

    def node(s: State, reading: Reading, seen: Floats) -> State:
        """The state with a new node, read and solved."""
        T = np.eye(n + 2 * p)
        T[:n, :n] = s.F
        added = np.concatenate([np.zeros(n), s.since * believed.drift])
        cov: Floats = T @ s.cov @ T.T + np.diag(added)
        cov[:n, :n] += s.G @ s.G.T
        C, offset = output(s.X[:n])
        y, side = np.where(seen, reading.y / sensor.slope, 0.0), np.where(seen, reading.side, 0.0)
        newest = Window(
            y,
            side,
            1.0 * seen,
            s.X,
            cov,
            C,
            offset,
            np.zeros((n, n)),
            np.zeros(n),
            np.zeros((n, m)),
        )
        left = s.window._replace(
            **{
                name: np.concatenate([getattr(s.window, name)[:-1], getattr(s, name)[None]])
                for name in ("F", "f", "G")
            }
        )
        window = Window(
            *(np.concatenate([old[1:], new[None]]) for old, new in zip(left, newest, strict=True))
        )
        found = horizon.estimate(window, weights, solve)
        for i in range(p):
            if side[i] != 0:
                cov = _read(cov, _row(C, i, side[i]), believed.R[i])
        return State(
            window,
            s.X if found is None else found,
            cov,
            np.eye(n),
            np.zeros(n),
            np.zeros((n, m)),
            0,
        )

    def correct(s: State, reading: Reading) -> tuple[State, Any]:
        seen = np.isfinite(reading.y)
        side = np.where(seen, reading.side, 0.0)
        C, offset = output(s.X[:n])
        rows = np.stack([_row(C, i, side[i]) for i in range(p)])
        e = np.where(
            side != 0, np.where(seen, reading.y / sensor.slope, 0.0) - rows @ s.X - offset, 0.0
        )
        e_std = np.sqrt(np.einsum("ij,jk,ik->i", rows, s.cov, rows) + believed.R)
        if s.since % stride == 0:
            s = node(s, reading, seen)
        C, offset = output(s.X[:n])
        pairs = np.hstack([np.zeros((p, n)), np.eye(p), np.eye(p)])
        both = np.sqrt(np.einsum("ij,jk,ik->i", pairs, s.cov, pairs))
        std = np.sqrt(np.maximum(np.diag(s.cov), 0.0))
        return s, numeric_estimate(s.X, C @ s.X[:n] + offset, reading, sensor, e, std, both, e_std)

    def predict(s: State, u: Floats) -> State:
        x, A, B = move(s.X[:n], u)
        return s._replace(
            X=np.concatenate([x, s.X[n:]]),
            F=A @ s.F,
            f=A @ s.f + x - A @ s.X[:n],
            G=A @ s.G + B * rms,
            since=s.since + 1,
        )

    return NumericObserver(believed, start, correct, predict)


def _row(C: Floats, i: int, side: float) -> Floats:
    """h of the reading z_i - d_r or z_i + d_l, linear in [x; d_r; d_l]; of z_i itself with side 0."""
    p = C.shape[0]
    edges = np.zeros(2 * p)
    edges[i], edges[p + i] = -1.0 * (side > 0), 1.0 * (side < 0)
    return np.concatenate([C[i], edges])


def _read(cov: Floats, h: Floats, R: float) -> Floats:
    """The covariance after a reading h X + v, var v = R (Joseph's form)."""
    K = cov @ h / (h @ cov @ h + R)
    half = np.eye(len(h)) - np.outer(K, h)
    return np.asarray(half @ cov @ half.T + R * np.outer(K, K))


def _tangents(model: System) -> tuple[Any, Any]:
    """(move(x, u) -> (x+, dx+/dx, dx+/du), output(x) -> (C, offset) with z = C x + offset) of the model at a point, on numbers."""
    if not model.nonlinear:
        A, B, C = model.linear
        return lambda x, u: (A @ x + B @ u, A, B), lambda x: (C, np.zeros(model.p))
    x, u = ca.SX.sym("x", model.n), ca.SX.sym("u", model.m)
    params = ca.SX(model.params)
    after, z = model.move(params, x, u), model.output(params, x)
    C = ca.densify(ca.jacobian(z, x))
    moved = ca.Function(
        "move",
        [x, u],
        [after, ca.densify(ca.jacobian(after, x)), ca.densify(ca.jacobian(after, u))],
        {"cse": True},
    )
    seen = ca.Function("output", [x], [C, z - C @ x])

    def move(x: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
        after, A, B = (part.full() for part in moved(x, u))
        return after[:, 0], A, B

    def output(x: Floats) -> tuple[Floats, Floats]:
        C, offset = (part.full() for part in seen(x))
        return C, offset[:, 0]

    return move, output
