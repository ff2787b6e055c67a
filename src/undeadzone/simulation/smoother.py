"""Fixed-interval smoothing of the filter `kalman`: what a whole log says of each of its samples.

The filter runs forward; adjoint variables run backward (modified Bryson-Frazier form: Bierman 1973,
"Fixed interval smoothing with discrete measurements", Int. J. Control 18). It gives what the
equations of Rauch, Tung and Striebel (1965) give, but inverts no covariance: without a disturbance
their gain is the inverse of the motion, and errors would grow with every step backward.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine import interpret
from undeadzone.interfaces import Estimate, Observer
from undeadzone.observers.parts.even_states import even_units
from undeadzone.plants.system import System, in_units
from undeadzone.sensor import Zone
from undeadzone.simulation.observer_graph import Out, observer_graph
from undeadzone.support import tree
from undeadzone.support.arrays import Floats


class Smoothed(NamedTuple):
    """What a whole log says of each of its samples.

    Attributes:
        x: state (N x n).
        z: output C x (N x p) [z].
        d: widths [d_r, d_l] of each output (N x 2p) [z].
        x_std, d_std: standard deviations of x and d.
    """

    x: Floats
    z: Floats
    d: Floats
    x_std: Floats
    d_std: Floats


class _Forward(NamedTuple):
    """What the filter had at each sample.

    Attributes:
        mean: of [x; all d_r; all d_l] before the reading (N x size).
        cov: its covariance (N x size x size).
        innovation, variance: of each output (N x p); an innovation of 0 was not used.
        right: whether the reading was positive (N x p).
    """

    mean: Floats
    cov: Floats
    innovation: Floats
    variance: Floats
    right: Any


def smooth(model: System, observer: Observer, sensor: Zone, y: Floats, u: Floats) -> Smoothed:
    """The smoothed estimates along a log.

    The equations hold for readings that are taken as they are or not at all: give the filter
    without glitches, and readings of which those that it would refuse are missing.

    Args:
        model: the sampled, linear model.
        observer: the filter `kalman` that is built for it.
        sensor: the dead zone, for its threshold and its range.
        y: readings (N x p), NaN where one is missing.
        u: inputs (N x m), NaN where the last one is held.
    """
    forward = _filtered(model, observer, sensor, y, u)
    units = even_units(model)
    model = in_units(model, units)
    F = np.eye(forward.mean.shape[1])
    F[: model.n, : model.n] = model.linear.A
    mean, std = _backward(model, F, forward)
    n, p = model.n, model.p
    order = n + np.arange(2 * p).reshape(2, p).T.ravel()  # right and left of each output in turn
    x = mean[:, :n]
    z = x @ model.linear.C.T
    return Smoothed(units * x, z, mean[:, order], units * std[:, :n], std[:, order])


def _filtered(model: System, observer: Observer, sensor: Zone, y: Floats, u: Floats) -> _Forward:
    """The filter along the log, with its beliefs before each reading."""
    graph, state, params, shapes = observer_graph(model, observer, sensor)
    s = ca.SX.sym("s", graph.size1_in(0))
    w = ca.SX.sym("w", graph.size1_in(1))
    q = ca.SX.sym("p", graph.size1_in(2))
    following, out = graph(s, w, q)
    watched = ca.Function("watched", [s, w, q], [following, ca.vertcat(out, s)])
    rows, _ = interpret.run(watched, state, np.hstack([y, u]), params)
    where: Out = tree.slices(shapes)
    inner, _ = tree.slices((observer.init(observer.params), np.zeros(model.m)))
    states = rows[:, graph.size1_out(1) :]
    belief = inner.filter
    mean = states[:, belief.mean]
    size = mean.shape[1]
    row, column = ca.Sparsity.upper(size).get_triplet()
    cov = np.empty((len(rows), size, size))
    cov[:, row, column] = states[:, belief.cov]
    cov[:, column, row] = states[:, belief.cov]
    estimate: Estimate = where.estimate
    return _Forward(
        mean, cov, rows[:, estimate.innovation], rows[:, estimate.innovation_std] ** 2, y > 0
    )


def _backward(model: System, F: Floats, forward: _Forward) -> tuple[Floats, Floats]:
    """Mean and standard deviation of [x; d] at each sample (N x size), given the whole log."""
    total, size = forward.mean.shape
    mean, std = np.empty((total, size)), np.empty((total, size))
    ahead, information = np.zeros(size), np.zeros((size, size))  # what the later samples say
    for k in range(total - 1, -1, -1):
        P = forward.cov[k]
        for h, K, e, S in reversed(_updates(model, forward, k)):
            closed = np.eye(size) - np.outer(K, h)
            ahead = closed.T @ ahead + h * (e / S)
            information = closed.T @ information @ closed + np.outer(h, h) / S
        mean[k] = forward.mean[k] + P @ ahead
        variance = np.diag(P) - np.einsum("ij,jk,ki->i", P, information, P)
        std[k] = np.sqrt(np.maximum(variance, 0.0))
        ahead = F.T @ ahead
        information = F.T @ information @ F
    return mean, std


def _updates(model: System, forward: _Forward, k: int) -> list[tuple[Floats, Floats, float, float]]:
    """(h, gain, innovation, its variance) of each reading that was used at a sample, in order."""
    n, p = model.n, model.p
    P = forward.cov[k]
    updates: list[tuple[Floats, Floats, float, float]] = []
    for i in range(p):
        e, S = float(forward.innovation[k, i]), float(forward.variance[k, i])
        if e == 0:
            continue
        h = np.zeros(len(P))
        h[:n] = model.linear.C[i]
        if forward.right[k, i]:
            h[n + i] = -1.0
        else:
            h[n + p + i] = 1.0
        K = P @ h / S
        P = P - np.outer(K, h @ P)
        updates.append((h, K, e, S))
    return updates
