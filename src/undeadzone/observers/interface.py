"""The one shape of every observer: params, init, step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.sensor import inverse, present


class Reading(NamedTuple):
    """What the sensor gives: y (p), NaN where missing, and its measured side (+1 right, -1 left, 0 silent)."""

    y: Any
    side: Any


NONE = ca.SX(0, 1)


class Estimate(NamedTuple):
    """x^ (n), z^ = C x^ (p), widths d_r^, d_l^ (p each), the deadzone inverse y + chi_bar d^ of (26) (p), innovation (p).

    Where the observer knows how sure it is, the standard deviations of x^, d_r^, d_l^, d_r^ + d_l^ and the innovation;
    else these are empty.
    """

    x: Any
    z: Any
    right: Any
    left: Any
    z_inverse: Any
    innovation: Any
    x_std: Any = NONE
    right_std: Any = NONE
    left_std: Any = NONE
    width_std: Any = NONE
    innovation_std: Any = NONE


class Observer(NamedTuple):
    """An observer as pure functions on CasADi expressions.

    params: tree of NumPy arrays; init(params): the state at t = 0, a tree of NumPy arrays;
    step(params, state, u, reading): (the state's derivative, or its next value when the model is sampled, Estimate),
    where the estimate must not depend on u; project(params, state): the admissible state nearest to a given one.
    """

    params: Any
    init: Callable[[Any], Any]
    step: Callable[[Any, Any, Any, Reading], tuple[Any, Estimate]]
    project: Callable[[Any, Any], Any] = lambda params, state: state


def estimate(x: Any, z: Any, right: Any, left: Any, reading: Reading, slope: Any, kind: str, innovation: Any) -> Estimate:
    """An `Estimate` with its deadzone inverse; a missing sample is inverted to z^."""
    inverted = ca.if_else(present(reading.y), inverse(reading.y, reading.side, right, left, slope, kind), z)
    return Estimate(x, z, right, left, inverted, innovation)
