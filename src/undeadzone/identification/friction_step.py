"""One sample of a plant with Coulomb friction, a zone of its input, or both, as a graph (F).

With friction the plant's recursion holds a dead zone of its own:
w_t = - a_1 z_(t-1) - ... + b_1 u_(t-1) + ... - c_1 f_(t-1) - ... - c_n f_(t-n),
z_t = Dz(w_t), f_t = w_t - z_t. With c = a this is exactly a zone of the sensor; with c_n = 0 it is
friction at a measured velocity.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.compile import lanes
from undeadzone.support.arrays import Floats

WIDTH = 32
FAR = 1e6  # a z beyond it has run away


def zone(x: Any, right: Any, left: Any) -> Any:
    """Dz(x) on CasADi expressions."""
    return ca.fmax(x - right, 0.0) + ca.fmin(x + left, 0.0)


@cache
def kernel(n: int, m: int, position: bool) -> lanes.Kernel:
    """The compiled step.

    Args:
        n: order of the plant.
        m: inputs.
        position: whether z is a position, which sticks where it is, and not a velocity.

    Returns:
        A kernel whose state is (z, f, each of the last n samples, and whether it stuck), whose
        inputs are the lagged inputs (m n) and unit pulses at the first n samples, whose lanes
        differ in (a, b, x0, c, phi_r, phi_l, sigma, zone of the input right and left), and whose
        output is z.
    """
    state = ca.SX.sym("s", 2 * n + 1)
    exogenous = ca.SX.sym("w", m * n + n)
    numbers = ca.SX.sym("p", 3 * n + m * n + 5)
    a, b = numbers[:n], numbers[n : n + m * n]
    x0, c = numbers[n + m * n : 2 * n + m * n], numbers[2 * n + m * n : 3 * n + m * n]
    right, left, sigma, u_right, u_left = ca.vertsplit(numbers[3 * n + m * n :])
    past = ca.vertsplit(state)
    z_past, f_past, moved = past[:n], past[n : 2 * n], past[2 * n]
    u = zone(exogenous[: m * n], u_right, u_left)
    w = ca.dot(b, u) + ca.dot(x0, exogenous[m * n :])
    w = w - ca.dot(a, ca.vertcat(*z_past)) - ca.dot(c, ca.vertcat(*f_past))
    w = ca.fmax(ca.fmin(w, FAR), -FAR)
    rest = z_past[0] if position else 0.0
    push = w - rest
    held = 1 + sigma * (moved == 0)
    slides = ca.logic_or(push > right * held, push < -left * held)
    move = ca.if_else(slides, zone(push, right, left), 0.0)
    z = rest + move
    following = ca.vertcat(z, *z_past[: n - 1], push - move, *f_past[: n - 1], move)
    step = ca.Function("friction", [state, exogenous, numbers], [following, z])
    return lanes.build(step, params=list(range(numbers.shape[0])), width=WIDTH, fused=True)


def simulate(n: int, m: int, position: bool, exogenous: Floats, numbers: Floats) -> Floats:
    """z of a record for several sets of numbers.

    Args:
        n, m, position: as for `kernel`.
        exogenous: lagged inputs and pulses (N x (m n + n)).
        numbers: one row a set (K x (3 n + m n + 5)).

    Returns:
        z (K x N).
    """
    outputs, _ = lanes.run(
        kernel(n, m, position),
        np.zeros((len(numbers), 2 * n + 1)),
        exogenous,
        np.zeros(numbers.shape[1]),
        lane_params=numbers,
        threads=1,
    )
    return outputs[:, :, 0]
