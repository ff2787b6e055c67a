"""Quadratic programme of moving horizon estimation behind a dead zone.

Its unknowns are in units of standard deviations (docs/methods/nonlinear_filters.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.util.arrays import Floats

# Of OSQP, whose own tolerance is 1e-3.
TIGHT = {"verbose": False, "eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20000}


class Window(NamedTuple):
    """N + 1 nodes, oldest first, with the reading and the prior of each.

    The prior of a node is about X = `[x; d_r; d_l]`. The disturbance w has unit variance.

    Attributes:
        y: reading y / m (p).
        side: measured side (p), +2 or -2 at a limit of the range.
        seen: whether there was a reading (p).
        mean: mean of X (n + 2p).
        cov: covariance of X (n + 2p x n + 2p).
        C, offset: z = C x + offset at the node (p x n, p).
        F, f, G: x of the next node = F x + f + G w (n x n, n, n x m) (0 for the newest node, as
            they are not yet known).
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


class HorizonWeights(NamedTuple):
    """Weights of the errors in the programme.

    Attributes:
        noise: rms of a reading (p) [z].
        slack: rms of the violation of a bound: by a silent sensor, or at a limit (p) [z].
        gate: z beyond an edge that a silent reading leaves open (p) [z].
        ranges: assumed ranges of the widths (2p x 2) [z].
    """

    noise: Floats
    slack: Floats
    gate: Floats
    ranges: Floats


Solver = Callable[[Floats, Floats, Floats, Floats, Floats], Floats | None]
"""(H, g, A, low, high) -> v, None if it failed."""


def build_qp_solver(plugin: str, unknowns: int, rows: int) -> Solver:
    """Build a solver of min v'Hv / 2 + g'v subject to low <= A v <= high, by CasADi.

    Args:
        plugin: CasADi's name of the solver.
        unknowns: size of v.
        rows: rows of A.
    """
    shapes = {"h": ca.Sparsity.dense(unknowns, unknowns), "a": ca.Sparsity.dense(rows, unknowns)}
    programme = ca.conic("horizon", plugin, shapes, {"osqp": TIGHT} if plugin == "osqp" else {})
    arguments = {name: np.zeros(programme.numel_in(name)) for name in programme.name_in()}
    v = np.zeros(unknowns)
    arguments["lbx"][:] = -np.inf
    arguments["ubx"][:] = np.inf
    buffer, evaluate = programme.buffer()  # without it, conversions take longer than the solution
    for i, part in enumerate(arguments.values()):
        buffer.set_arg(i, part.data)
    buffer.set_res(programme.name_out().index("x"), v.data)

    def solve(H: Floats, g: Floats, A: Floats, low: Floats, high: Floats) -> Floats | None:
        """Return the minimiser v, or None if the solver failed."""
        for name, part in (("h", H), ("g", g), ("a", A), ("lba", low), ("uba", high)):
            arguments[name][:] = part.ravel(order="F")
        try:
            evaluate()
        except RuntimeError:  # not solved, or not numbers any more
            return None
        solved = buffer.ret() == 0 and np.isfinite(v).all()  # naming buffer keeps it alive
        return v.copy() if solved else None

    return solve


def programme_size(window: Window) -> tuple[int, int]:
    """Return the numbers of unknowns and rows of the programme.

    The unknowns are X at the oldest node, disturbances and violations. The rows are two edges a
    node, and the widths.
    """
    nodes, n, m = window.G.shape
    p = window.y.shape[1]
    return n + 2 * p + (nodes - 1) * m + nodes * p, 2 * nodes * p + 2 * p


class Affine(NamedTuple):
    """Affine function M v + b of the programme's unknowns v."""

    M: Floats
    b: Floats


def solve_horizon(window: Window, weights: HorizonWeights, solve: Solver) -> Floats | None:
    """Return X (n + 2p) at the newest node, or None if the programme was not solved.

    The unknowns are X = mean + root cov xi at the oldest node, the disturbances w, and the
    violation s slack of a censored sample's zone by z. The cost is |xi|^2 + |w|^2 + |s|^2 + sum
    over active nodes of (error of the reading / noise)^2.

    Args:
        window: the nodes.
        weights: weights of the errors.
        solve: the solver.
    """
    unknowns, _ = programme_size(window)
    start = oldest_node(window)
    n = window.G.shape[1]
    d = Affine(start.M[n:], start.b[n:])
    xs, newest = node_trajectory(window, Affine(start.M[:n], start.b[:n]))
    beyond = excess_over_breakpoints(window, xs, d)
    M, b = reading_errors(window, weights, beyond)
    A, low, high = qp_constraints(window, weights, beyond, d)
    v = solve(np.eye(unknowns) + M.T @ M, -M.T @ b, A, low, high)
    if v is None:
        return None
    return np.concatenate([newest.M @ v + newest.b, d.M @ v + d.b])


def oldest_node(window: Window) -> Affine:
    """Return X = mean + root cov xi at the oldest node."""
    unknowns, _ = programme_size(window)
    values, vectors = np.linalg.eigh(window.cov[0])
    known = len(values)
    root = np.zeros((known, unknowns))
    root[:, :known] = vectors * np.sqrt(np.maximum(values, 0.0))
    return Affine(root, window.mean[0])


def node_trajectory(window: Window, oldest: Affine) -> tuple[Affine, Affine]:
    """Return x of every node (nodes x n) from that of the oldest, and x of the newest.

    The disturbances w of a node stand in v behind X and those of the nodes before it.
    """
    nodes, n, m = window.G.shape
    first = n + 2 * window.y.shape[1]
    x, rest = oldest
    xs = [x]
    rests = [rest]
    for j in range(nodes - 1):
        x = window.F[j] @ x
        rest = window.F[j] @ rest + window.f[j]
        x[:, first + j * m : first + (j + 1) * m] += window.G[j]
        xs.append(x)
        rests.append(rest)
    return Affine(np.stack(xs), np.stack(rests)), Affine(x, rest)


def excess_over_breakpoints(window: Window, xs: Affine, d: Affine) -> Affine:
    """Return how far z is beyond the right breakpoint at every node, then -z beyond the left one.

    Each has nodes p rows [z].

    Args:
        window: the nodes.
        xs: x of every node.
        d: the widths `[d_r; d_l]`.
    """
    p = window.y.shape[1]
    unknowns = d.M.shape[1]
    z = window.C @ xs.M
    z_rest = (window.C @ xs.b[:, :, None])[:, :, 0] + window.offset
    return Affine(
        np.stack([z - d.M[:p], -z - d.M[p:]]).reshape(-1, unknowns),
        np.stack([z_rest - d.b[:p], -z_rest - d.b[p:]]).ravel(),
    )


def outward(values: Floats) -> Floats:
    """Return readings or sides of all nodes as counted outwards at the right, then at the left."""
    return np.concatenate([values.ravel(), -values.ravel()])


def reading_errors(
    window: Window, weights: HorizonWeights, beyond: Affine
) -> tuple[Floats, Floats]:
    """Return M and b:

    M v - b are the errors of readings outside the zone, in units of noise [1].
    """
    noise = np.tile(weights.noise, 2 * len(window.y))
    active = outward(window.side) == 1
    M = (beyond.M / noise[:, None])[active]
    b = ((outward(window.y) - beyond.b) / noise)[active]
    return M, b


def qp_constraints(
    window: Window, weights: HorizonWeights, beyond: Affine, d: Affine
) -> tuple[Floats, Floats, Floats]:
    """Return A, low and high of the bounds.

    Silent nodes are inside both edges, those at a limit beyond their reading, but for their
    violation. Widths are in their ranges.
    """
    nodes, p = window.y.shape
    silent = np.tile(((window.side == 0) & (window.seen > 0)).ravel(), 2)
    gate = np.tile(weights.gate, 2 * nodes)
    violation = np.zeros(beyond.M.shape)
    violation[:, -nodes * p :] = np.tile(np.diag(np.tile(weights.slack, nodes)), (2, 1))
    limited = outward(window.side) == 2
    low = np.where(limited, outward(window.y) - beyond.b, -np.inf)
    high = np.where(silent, gate - beyond.b, np.inf)
    return (
        np.vstack([beyond.M - violation, d.M]),
        np.append(low, weights.ranges[:, 0] - d.b),
        np.append(high, weights.ranges[:, 1] - d.b),
    )


def reading_row(C: Floats, i: int, side: float) -> Floats:
    """Return h of the reading z_i - d_r or z_i + d_l = h `[x; d_r; d_l]`.

    With side 0 it is that of z_i.
    """
    p = C.shape[0]
    edges = np.zeros(2 * p)
    edges[i] = -1.0 * (side > 0)
    edges[p + i] = 1.0 * (side < 0)
    return np.concatenate([C[i], edges])


def row_variances(rows: Floats, cov: Floats) -> Floats:
    """Return the variance of h X for each row h."""
    return np.asarray(np.einsum("ij,jk,ik->i", rows, cov, rows))


def covariance_after_reading(cov: Floats, h: Floats, R: float) -> Floats:
    """Return the covariance after a reading h X + v, var v = R (Joseph's form)."""
    K = cov @ h / (h @ cov @ h + R)
    half = np.eye(len(h)) - np.outer(K, h)
    return np.asarray(half @ cov @ half.T + R * np.outer(K, K))
