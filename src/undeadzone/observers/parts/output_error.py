"""Observers that correct by the output error y / m - Dz(C x^; d^): the reading against the dead zone of the estimate itself.

Sliding-mode, super-twisting and high-gain observers differ only in what they make of that error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Estimate, Observer, Reading, Traits, estimate
from undeadzone.observers.parts.widths import bounded_widths
from undeadzone.plants.system import System
from undeadzone.sensor import Zone, deadzone, jump, present
from undeadzone.support.arrays import Array, Floats, nonnegative


class Widths(NamedTuple):
    """gamma (p) [1/s], d^(0) (p x 2) [z] and their upper bound d_M (p)."""

    gamma: Floats
    start: Floats
    limit: Floats


class Params(NamedTuple):
    """Numbers of the observer; L, gamma and the injection's are per step when the model is sampled."""

    model: Any
    L: Floats
    gamma: Floats
    law: Any
    right0: Floats
    left0: Floats
    limit: Floats
    slope: Floats


class State(NamedTuple):
    """x^ and the widths d_r^, d_l^."""

    x: Any
    right: Any
    left: Any


def adapted(
    gamma: Array, widths0: Array, width_max: Array | None, model: System, sensor: Zone
) -> Widths:
    """Checked widths and their gain. Raises InputError, ShapeError."""
    found = nonnegative("observer.gamma", gamma, model.p, "one per output")
    if sensor.kind == "jump" and found.any():
        raise InputError(
            "observer.gamma: readings of a jump sensor only bound its widths, this method cannot adapt them; leave gamma out"
        )
    return Widths(found, *bounded_widths(widths0, width_max, model.p))


def measured(law: Any, s: State, z: Any, reading: Reading) -> tuple[Any, Any]:
    """Whether the reading is on the right, on the left (p each)."""
    return reading.side > 0, reading.side < 0


def output_error(
    model: System, sensor: Zone, L: Floats, widths: Widths, law: Any = (),
    inject: Callable[[Any, Any], Any] = lambda law, e: 0.0, where: Callable[[Any, State, Any, Reading], tuple[Any, Any]] = measured,
) -> Observer:  # fmt: skip
    """x^' = A x^ + B u + L e + inject(law, e), d_r^' = -gamma e on the right, d_l^' = gamma e on the left, within [0, d_M].

    e = y / m - Dz(C x^; d^) (p), 0 where the reading is missing; with d^ = 0, y / m - C x^. L and what inject returns are
    per step when the model is sampled. where(law, state, C x^, reading): how much each side is adapted (p each, 0 to 1).
    """
    per_step, keep = (1.0, 0.0) if model.Ts is None else (model.Ts, 1.0)
    params = Params(
        model.params,
        L,
        widths.gamma * per_step,
        law,
        widths.start[:, 0],
        widths.start[:, 1],
        widths.limit,
        sensor.slope,
    )

    def project(p: Params, s: State) -> State:
        return State(s.x, *(ca.fmax(ca.fmin(width, p.limit), 0.0) for width in (s.right, s.left)))

    def step(p: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        z = model.output(p.model, s.x)
        expected = (jump if sensor.kind == "jump" else deadzone)(z, s.right, s.left)
        e = ca.if_else(present(reading.y), reading.y / p.slope - expected, 0.0)
        right, left = where(p.law, s, z, reading)
        after = State(
            model.move(p.model, s.x, u) + p.L @ e + inject(p.law, e),
            keep * s.right - p.gamma * e * right,
            keep * s.left + p.gamma * e * left,
        )
        return after if model.Ts is None else project(p, after), estimate(
            s.x, z, s.right, s.left, reading, p.slope, sensor.kind, e
        )

    traits = Traits(
        L=L,
        gamma=params.gamma,
        width_max=widths.limit,
        adapts=bool(widths.gamma.any()),
    )

    def init(p: Params) -> State:
        return State(np.zeros(model.n), p.right0, p.left0)

    return Observer(params, init, step, project, traits)
