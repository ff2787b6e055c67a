"""The quadratic programme of moving horizon estimation behind a dead zone, in units of standard deviations (docs/methods/moving_horizon.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.support.arrays import Floats

TIGHT = {
    "verbose": False,
    "eps_abs": 1e-6,
    "eps_rel": 1e-6,
    "max_iter": 20000,
}  # of OSQP, whose own tolerance is 1e-3


class Window(NamedTuple):
    """N + 1 nodes, oldest first. Of each: what it read and the belief about X = [x; d_r; d_l] that all nodes before it left.

    y (p): reading y / m; side (p), seen (p); mean (n + 2p), cov; C (p x n), offset (p): z = C x + offset there. F (n x n),
    f (n), G (n x m): x of the next node = F x + f + G w, w of unit variance; those of the newest are not yet known, 0.
    """

    y: Floats
    side: Floats
    seen: Floats
    mean: Floats
    cov: Floats
    C: Floats
    offset: Floats
    F: Floats
    f: Floats
    G: Floats


class Weights(NamedTuple):
    """rms of a reading (p) and of a silent sensor's violation (p) [z]; z that a silent reading leaves open (p); ranges of d (2p x 2)."""

    noise: Floats
    slack: Floats
    gate: Floats
    ranges: Floats


Solver = Callable[
    [Floats, Floats, Floats, Floats, Floats], Floats | None
]  # (H, g, A, low, high) -> v, None if it failed


def solver(plugin: str, unknowns: int, rows: int) -> Solver:
    """min v'Hv / 2 + g'v subject to low <= A v <= high, by one of CasADi's solvers for convex programmes."""
    sizes = {"h": ca.Sparsity.dense(unknowns, unknowns), "a": ca.Sparsity.dense(rows, unknowns)}
    programme = ca.conic("horizon", plugin, sizes, {"osqp": TIGHT} if plugin == "osqp" else {})
    given, v = (
        {name: np.zeros(programme.numel_in(name)) for name in programme.name_in()},
        np.zeros(unknowns),
    )
    given["lbx"][:], given["ubx"][:] = -np.inf, np.inf
    buffer, evaluate = programme.buffer()  # without it, conversions take longer than the solution
    for i, part in enumerate(given.values()):
        buffer.set_arg(i, part.data)
    buffer.set_res(programme.name_out().index("x"), v.data)

    def solve(H: Floats, g: Floats, A: Floats, low: Floats, high: Floats) -> Floats | None:
        for name, part in (("h", H), ("g", g), ("a", A), ("lba", low), ("uba", high)):
            given[name][:] = part.ravel(order="F")
        try:
            evaluate()
        except RuntimeError:  # not solved, or not numbers any more
            return None
        solved = buffer.ret() == 0 and bool(
            np.isfinite(v).all()
        )  # which also keeps the buffer alive
        return v.copy() if solved else None

    return solve


def size(window: Window) -> tuple[int, int]:
    """(unknowns, rows) of the programme: of X at the oldest node, disturbances, violations; two edges a node, widths."""
    nodes, n, m = window.G.shape
    p = window.y.shape[1]
    return n + 2 * p + (nodes - 1) * m + nodes * p, 2 * nodes * p + 2 * p


def estimate(window: Window, weights: Weights, solve: Solver) -> Floats | None:
    """X (n + 2p) at the newest node; None if the programme was not solved.

    Unknown are X = mean + root cov xi at the oldest node, the disturbances w, and how far z is outside a silent sensor's
    zone, s slack; minimised is |xi|^2 + |w|^2 + |s|^2 + sum over active nodes of (error of the reading / noise)^2.
    """
    nodes, n, m = window.G.shape
    p = window.y.shape[1]
    unknowns, _ = size(window)
    known, shaken = n + 2 * p, n + 2 * p + (nodes - 1) * m
    values, vectors = np.linalg.eigh(window.cov[0])
    root = np.zeros((known, unknowns))
    root[:, :known] = vectors * np.sqrt(np.maximum(values, 0.0))
    x, rest = root[:n], window.mean[0, :n]
    xs, rests = [x], [rest]
    for j in range(nodes - 1):
        x, rest = window.F[j] @ x, window.F[j] @ rest + window.f[j]
        x[:, known + j * m : known + (j + 1) * m] += window.G[j]
        xs.append(x)
        rests.append(rest)
    z, z_rest = (
        window.C @ np.stack(xs),
        (window.C @ np.stack(rests)[:, :, None])[:, :, 0] + window.offset,
    )
    d, d_rest = root[n:], window.mean[0, n:]
    # What z is beyond either edge: M v + b, nodes x p rows.
    right, right_rest = (z - d[:p]).reshape(-1, unknowns), (z_rest - d_rest[:p]).ravel()
    left, left_rest = (z + d[p:]).reshape(-1, unknowns), (z_rest + d_rest[p:]).ravel()
    y, side, silent = (
        window.y.ravel(),
        window.side.ravel(),
        ((window.side == 0) & (window.seen > 0)).ravel(),
    )
    noise, slack, gate = (np.tile(part, nodes) for part in weights[:3])
    active, rightward = side != 0, (side > 0)[:, None]
    M = (np.where(rightward, right, left) / noise[:, None])[active]
    b = ((y - np.where(side > 0, right_rest, left_rest)) / noise)[active]
    violation = np.hstack([np.zeros((nodes * p, shaken)), np.diag(slack)])
    low = np.concatenate(
        [
            np.full(nodes * p, -np.inf),
            np.where(silent, -gate - left_rest, -np.inf),
            weights.ranges[:, 0] - d_rest,
        ]
    )
    high = np.concatenate(
        [
            np.where(silent, gate - right_rest, np.inf),
            np.full(nodes * p, np.inf),
            weights.ranges[:, 1] - d_rest,
        ]
    )
    v = solve(
        np.eye(unknowns) + M.T @ M,
        -M.T @ b,
        np.vstack([right - violation, left + violation, d]),
        low,
        high,
    )
    return None if v is None else np.concatenate([xs[-1] @ v + rests[-1], d @ v + d_rest])
