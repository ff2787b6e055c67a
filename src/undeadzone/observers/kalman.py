"""Measured-side Kalman filter on [x; d]: exact where the side is certain (docs/filters.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.arrays import Array, Floats, array, matrix, nonnegative, vector
from undeadzone.errors import InputError
from undeadzone.gaussian import Gaussian, cut, predict, room, symmetric, triangle, update
from undeadzone.observers.interface import Estimate, Observer, Reading, estimate
from undeadzone.plant import System
from undeadzone.sensor import Zone, side


class Kalman(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="method", tag="kalman"):
    right: Array
    left: Array | None = None
    noise: Array | None = None
    x_std: Array | None = None
    disturbance: Array = 0.0
    drift: Array = 0.0

    def build(self, model: System, sensor: Zone) -> Observer:
        """x"""
        b = beliefs(self, model, sensor)
        return filtering(model, sensor, b, Extra(Dummy(nonnegative("observer.disturbance", self.disturbance, model.m)), plain_move, plain_noise), None)


class Dummy(NamedTuple):
    var: Any


class Extra(NamedTuple):
    params: Any
    move: Any
    noise: Any
    std: Any = ()


def plain_move(model, p, X, u):
    n = model.n
    return ca.vertcat(model.move(p.model, X[:n], u), X[n:])


def plain_noise(model, p, X, u):
    n = model.n
    u_ = ca.SX.sym("u", model.m)
    B = ca.substitute(ca.jacobian(model.move(p.model, X[:n], u_), u_), u_, u)
    return B @ ca.diag(p.extra.var**2) @ B.T


class Beliefs(NamedTuple):
    x_std: Floats
    right: Floats
    left: Floats
    d_std: Floats
    R: Floats
    gate: Floats
    drift: Floats


def beliefs(options: Any, model: System, sensor: Zone) -> Beliefs:
    if model.Ts is None:
        raise InputError(f"observer.method: {options.__struct_config__.tag!r} works on samples; set simulation.time to \"sampled\"")
    p = model.p
    r = np.broadcast_to(array("observer.right", options.right), (p, 2))
    l = r if options.left is None else np.broadcast_to(array("observer.left", options.left), (p, 2))
    span = np.concatenate([r[:, 1] - r[:, 0], l[:, 1] - l[:, 0]])
    d_std = span / np.sqrt(12)
    noise = np.hypot(sensor.noise / sensor.slope, sensor.noise_before)
    gate = np.maximum(sensor.threshold, 4 * noise * sensor.slope)
    if options.noise is None:
        noise = np.maximum(noise, 1e-3 * span.max())
    else:
        noise = vector("observer.noise", options.noise, p)
    x_std = np.full(model.n, 5 * r.max()) if options.x_std is None else vector("observer.x_std", options.x_std, model.n)
    return Beliefs(x_std, r.mean(1), l.mean(1), d_std, noise**2, gate, np.full(2 * p, float(options.drift) ** 2 * model.Ts))


class Params(NamedTuple):
    model: Any
    R: Any
    gate: Any
    slope: Any
    drift: Any
    extra: Any
    mean: Any
    std: Any


class State(NamedTuple):
    mean: Any
    cov: Any
    last: Any
    before: Any
    wait: Any


def filtering(model, sensor, b, extra, silence) -> Observer:
    n, p = model.n, model.p
    k = n + 2 * p
    from scipy.linalg import block_diag
    ex = np.zeros((0,0)) if len(extra.std)==0 else extra.std
    std = block_diag(np.diag(np.concatenate([b.x_std, b.d_std])**2), ex) if len(ex) else np.diag(np.concatenate([b.x_std, b.d_std])**2)
    N = len(std)
    jump = sensor.kind == "jump"
    params = Params(model.params, b.R, b.gate, sensor.slope, b.drift, extra.params, np.concatenate([np.zeros(n), b.right, b.left, np.zeros(N - k)]), std)

    def init(p_):
        cov = p_.std
        col = np.concatenate([cov[: j + 1, j] for j in range(N)])
        return State(p_.mean, col, np.zeros(p), np.zeros(p), np.zeros(2 * p))

    def step(q, s, u, reading):
        belief = Gaussian(s.mean, symmetric(s.cov, N))
        gate = gated(reading, s.last, s.before, q.gate)
        known = reading.y == reading.y
        y = ca.if_else(known, reading.y, 0.0)
        es, Ss, waits = [], [], []
        for i in range(p):
            right, left = gate[i] > 0, gate[i] < 0
            h = row(model, q, belief.mean, i, -right, left)
            e = y[i] / q.slope[i] - value(model, q, belief.mean, i, right, left)
            use = ca.logic_or(right, left)
            belief, S = update(belief, h, e, q.R[i], use)
            es.append(ca.if_else(use, e, 0.0))
            Ss.append(ca.sqrt(S))
        wait = s.wait
        if silence is not None:
            quiet = ca.logic_and(known, ca.fabs(y) <= q.gate)
            new = []
            for i in range(p):
                for edge, sign in ((0, 1), (1, -1)):
                    h = sign * row(model, q, belief.mean, i, -1.0 if edge == 0 else 0.0, 1.0 if edge else 0.0)
                    bound = q.gate[i] / q.slope[i]
                    w = wait[2 * i + edge]
                    a = room(belief, h, bound, q.R[i])
                    use = ca.logic_and(ca.logic_and(quiet[i], a < silence[0]), w <= 0)
                    belief = cut(belief, h, bound, q.R[i], use)
                    new.append(ca.if_else(use, silence[1] / model.Ts, w - 1))
            wait = ca.vertcat(*new)
        X = ca.SX.sym("X", N)
        following = extra.move(model, q, X, u)
        F = ca.jacobian(following, X)
        Q = ca.diagcat(extra.noise(model, q, X, u), ca.diag(q.drift)) if isinstance(extra.params, Dummy) else ca.diagcat(ca.SX(n, n), ca.diag(q.drift), extra.noise(model, q, X, u))
        following, F, Q = ca.substitute([following, F, Q], [X], [belief.mean])
        after = predict(belief, following, F, Q)
        x, right, left = belief.mean[:n], belief.mean[n : n + p], belief.mean[n + p : k]
        var = ca.diag(belief.cov)
        z = model.output(q.model, x)
        state = State(after.mean, triangle(after.cov), y, s.last, wait)
        cross = ca.vertcat(*(belief.cov[n + i, n + p + i] for i in range(p)))
        st = ca.sqrt(var)
        out = estimate(x, z, right, left, reading, q.slope, sensor.kind, ca.vertcat(*es))
        return state, out, (st, ca.sqrt(var[n:n+p] + var[n+p:k] + 2*cross), ca.sqrt(var[n:n+p] + var[n+p:k] - 2*cross)/2, ca.vertcat(*Ss))

    return Observer(params, init, step)


def row(model, q, X, i, a, b):
    n, p = model.n, model.p
    x = ca.SX.sym("x", n)
    C = ca.substitute(ca.jacobian(model.output(q.model, x)[i], x), x, X[:n])
    h = ca.SX(1, X.shape[0])
    h[0, :n] = C
    h[0, n + i] = a
    h[0, n + p + i] = b
    return h


def value(model, q, X, i, right, left):
    n, p = model.n, model.p
    return model.output(q.model, X[:n])[i] - right * X[n + i] + left * X[n + p + i]


def gated(reading, last, before, gate):
    y = reading.y
    out = []
    for i in range(gate.shape[0]):
        g = gate[i]
        def open_(sign):
            a, b, c = sign * last[i], sign * before[i], sign * y[i]
            steady = ca.logic_and(ca.logic_and(a > g, b > g), ca.logic_and(2 * a - b > g, c > 0))
            return ca.logic_or(c > 2 * g, steady)
        out.append(open_(1) - open_(-1))
    return ca.vertcat(*out)
