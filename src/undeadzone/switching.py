"""A Runge-Kutta step that finds where the sensor changes side inside it, so that its order survives the kink."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import casadi as ca

from undeadzone.integrate import hermite, hermite_slope, rk4


class Mode(Protocol):
    """A branch of the loop, with the side that is read on it (+1, 0, -1 per output)."""

    @property
    def side(self) -> Any:
        """The side that is read."""
        ...


class Crossing(NamedTuple):
    """What changed, per output: whether anything did, the side entered, which level was met, in which direction."""

    changed: Any
    side: Any
    upper: Any
    rising: Any


def located_step(
    rate: Callable[[ca.SX, Any, Any], ca.SX],
    output: Callable[[ca.SX], ca.SX],
    levels: tuple[ca.SX, ca.SX],
    first: Mode,
    second: Callable[[Crossing], Mode],
    x: ca.SX,
    h: ca.SX,
) -> ca.SX:
    """x after h [s] of x' = rate(x, c, mode), c the fraction of the step.

    The side is right above levels[0], left below levels[1] of z = output(x). RK4 runs on the branch `first`; if the
    side has changed at its end, the earliest change is located on the cubic dense output of z, and RK4 runs again from
    there on second(crossing). Branch-free: both are always computed. One change a step is located.
    """
    above, below = levels
    k1 = rate(x, 0.0, first)
    trial = rk4(lambda state, c: rate(state, c, first), x, h, k1)
    k5 = rate(trial, 1.0, first)
    z0, z1 = output(x), output(trial)
    v = ca.SX.sym("v", x.shape[0])
    slope = ca.Function("slope", [x, v], [ca.jtimes(z0, x, v)], {"allow_free": True})
    dz0, dz1 = slope(x, k1), slope(trial, k5)

    enters_right = ca.logic_and(first.side <= 0, z1 > above)
    enters_left = ca.logic_and(first.side >= 0, z1 < below)
    leaves_right = ca.logic_and(first.side > 0, z1 < above)
    leaves_left = ca.logic_and(first.side < 0, z1 > below)
    silent = first.side == 0
    upper = ca.logic_or(leaves_right, ca.logic_and(silent, enters_right))
    crosses = ca.logic_or(upper, ca.logic_or(leaves_left, enters_left))

    c = ca.if_else(crosses, _root(z0, dz0, z1, dz1, h, ca.if_else(upper, above, below)), 1.0)
    split = ca.mmin(c)
    entered = 1.0 * ca.logic_and(silent, enters_right) - 1.0 * ca.logic_and(silent, enters_left)
    rising = ca.logic_or(leaves_left, ca.logic_and(silent, enters_right))
    mode = second(Crossing(ca.logic_and(crosses, c <= split), entered, upper, rising))

    rest = 1.0 - split
    middle = hermite(x, k1, trial, k5, h, split)
    finished = rk4(lambda state, fraction: rate(state, split + fraction * rest, mode), middle, h * rest)
    return ca.if_else(ca.sum1(crosses) > 0, finished, trial)


def _root(z0: ca.SX, dz0: ca.SX, z1: ca.SX, dz1: ca.SX, h: ca.SX, level: ca.SX) -> ca.SX:
    """The fraction c in [0, 1] at which the cubic through z0 and z1 meets `level`, by Newton's method from the chord."""
    c = _unit((level - z0) / (z1 - z0))
    for _ in range(4):
        c = _unit(c - (hermite(z0, dz0, z1, dz1, h, c) - level) / hermite_slope(z0, dz0, z1, dz1, h, c))
    return c


def _unit(c: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(c, 0.0), 1.0)
