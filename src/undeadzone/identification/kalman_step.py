"""One sample of the measured-side Kalman filter as a graph, for many sets of numbers at once."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.compile.lanes import Kernel, build

LOG_ROOT = 0.5 * math.log(2 * math.pi)
TAIL = -4.0  # below it Phi is taken by its continued fraction
DEPTH = 12  # of the fraction: exact to rounding below TAIL
WIDTH = 32  # lanes of a kernel: the numbers of a plant of order 6, each a little up and down
WORST = -1e3  # log density of a sample where the filter has diverged
FLOOR = -1e4  # the least log density of a sample
NARROW = 1e-6  # a zone this narrow, in standard deviations, is a point


def log_phi(x: Any) -> Any:
    """ln Phi(x) on CasADi expressions."""
    near = ca.fmax(x, TAIL)
    far = ca.fmax(-x, -TAIL)
    fraction = far
    for k in range(DEPTH, 0, -1):
        fraction = far + k / fraction
    tail = -0.5 * far**2 - LOG_ROOT - ca.log(fraction)
    return ca.if_else(x > TAIL, ca.log(0.5 * (1 + ca.erf(near / math.sqrt(2)))), tail)


def log_mass(a: Any, b: Any) -> Any:
    """ln(Phi(a) - Phi(b)) on CasADi expressions, a > b."""
    flip = b > 0
    upper = ca.if_else(flip, -b, a)
    lower = ca.if_else(flip, -a, b)
    top = log_phi(upper)
    gap = ca.fmin(log_phi(lower) - top, -1e-12)
    width = ca.fmax(upper - lower, 1e-12)
    point = ca.log(width) - 0.5 * (0.5 * (upper + lower)) ** 2 - LOG_ROOT
    return ca.if_else(upper - lower < 1e-5, point, top + ca.log(1 - ca.exp(gap)))


class Correction:
    """A reading's log density, and g and k of x += P H' g / s, P -= P H' H P k / s^2.

    Without a side the reading is a level that z is near: 0 in a dead zone, y where a play holds.
    """

    def __init__(
        self, y: Any, side: Any, mean: Any, s: Any, right: Any, left: Any, slack: Any
    ) -> None:
        speaks = side != 0
        v = (y + right * (side > 0) - left * (side < 0) - mean) / s
        a, b = (y + right + slack - mean) / s, (y - left - slack - mean) / s
        mass = log_mass(a, b)
        at_a = ca.exp(ca.fmin(-0.5 * a**2 - LOG_ROOT - mass, 700.0))
        at_b = ca.exp(ca.fmin(-0.5 * b**2 - LOG_ROOT - mass, 700.0))
        lost = ca.logic_or(mass < -700.0, a - b < NARROW)
        shift = ca.if_else(lost, 0.0, at_b - at_a)
        shift = ca.fmin(ca.fmax(shift, b), a)
        narrowed = (at_b - at_a) ** 2 + a * at_a - b * at_b
        pinned = 1 - ca.fmin(1.0, (a - b) ** 2 / 12)
        narrowed = ca.fmin(ca.fmax(ca.if_else(lost, pinned, narrowed), 0.0), 1.0)
        spoken = -0.5 * v**2 - ca.log(s) - LOG_ROOT
        self.log = ca.fmax(ca.if_else(speaks, spoken, mass), FLOOR)
        self.g = ca.if_else(speaks, v, shift)
        self.k = ca.if_else(speaks, 1.0, narrowed)


@cache
def kernel(n: int, m: int, model: int, moments: bool = False) -> Kernel:
    """The compiled step.

    Args:
        n: order of the plant.
        m: inputs.
        model: disturbance: 0 white at the inputs, 1 first order at the inputs, 2 at the output.
        moments: whether its outputs are x, P before the reading, x, P after it, and g.

    Returns:
        A kernel whose state is (x, P column by column, upper part), whose inputs are (u, y, side,
        ok, start), whose lanes differ in (a, b input by input, q^2, r^2, d_r, d_l, phi, variance
        of x and of the disturbance at first, slack of a level), and whose output is the log
        density.
    """
    size = n + (model > 0)
    triangle = []
    for j in range(size):
        triangle += [(i, j) for i in range(j + 1)]
    state = ca.SX.sym("s", size + len(triangle))
    exogenous = ca.SX.sym("w", m + 4)
    numbers = ca.SX.sym("p", n + m * n + 8)
    F, B, G, H = matrices(n, m, model, numbers)
    q2, r2, right, left, _, first, first_w, slack = ca.vertsplit(numbers[n + m * n :])
    u = exogenous[:m]
    y, side, ok, start = ca.vertsplit(exogenous[m:])
    at_start = ca.diag(ca.vertcat(first * ca.SX.ones(n), *([first_w] * (model > 0))))
    P = ca.SX(size, size)
    for place, (i, j) in enumerate(triangle):
        entry = ca.if_else(start, at_start[i, j], state[size + place])
        P[i, j] = entry
        P[j, i] = entry
    x = ca.if_else(start, 0.0, state[:size])
    mean = H @ x
    PH = P @ H.T
    S = H @ PH + r2
    lost = ca.logic_not(ca.logic_and(S < 1e12, ca.fabs(mean) < 1e9))
    s = ca.sqrt(ca.fmax(ca.if_else(lost, 1.0, S), 1e-12))
    by_reading = Correction(y, side, ca.if_else(lost, 0.0, mean), s, right, left, slack)
    g, k = ok * by_reading.g, ok * by_reading.k
    before = [x, *[P[i, j] for i, j in triangle]]
    x = x + PH * g / s
    P = P - PH @ PH.T * k / s**2
    seen = ca.vertcat(*before, x, *[P[i, j] for i, j in triangle], g)
    x = F @ x + B @ u
    P = F @ P @ F.T + q2 * G
    following = [x] + [P[i, j] for i, j in triangle]
    log = ok * ca.if_else(lost, WORST, by_reading.log)
    out = seen if moments else log
    step = ca.Function("kalman", [state, exogenous, numbers], [ca.vertcat(*following), out])
    own = range(numbers.shape[0])
    return build(step, params=list(own), width=WIDTH, fused=True)


def matrices(n: int, m: int, model: int, numbers: Any) -> tuple[Any, Any, Any, Any]:
    """F, B, the noise's G G' and H of the plant in observer form, with its disturbance.

    Args:
        n, m, model: as for `kernel`.
        numbers: a (n), b (m n), then q^2, r^2, d_r, d_l, phi: an expression or an array.

    Returns:
        F (size x size), B (size x m), G G' (size x size) for q = 1, H (1 x size).
    """
    symbolic = type(numbers).__module__.startswith("casadi")
    zeros = ca.SX.zeros if symbolic else _zeros
    size = n + (model > 0)
    a = numbers[:n]
    phi = numbers[n + m * n + 4]
    F, B, G, H = zeros(size, size), zeros(size, m), zeros(size, size), zeros(1, size)
    for i in range(n):
        F[i, 0] = -a[i]
        if i < n - 1:
            F[i, i + 1] = 1.0
        for j in range(m):
            B[i, j] = numbers[n + n * j + i]
    H[0, 0] = 1.0
    if model == 0:
        for i in range(n):
            for j in range(n):
                for k in range(m):
                    G[i, j] = G[i, j] + B[i, k] * B[j, k]
        return F, B, G, H
    F[n, n] = phi
    G[n, n] = 1.0
    if model == 1:
        for i in range(n):
            F[i, n] = B[i, 0]
    else:
        H[0, n] = 1.0
    return F, B, G, H


def _zeros(rows: int, columns: int) -> Any:
    return np.zeros((rows, columns))
