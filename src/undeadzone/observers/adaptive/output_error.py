"""Observers that correct by the output error y / m - Dz(C x^, d^).

The reading is compared with the dead zone of the estimate itself. Sliding-mode, super-twisting and
high-gain observers differ only in their use of that error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import (
    Estimate,
    Observer,
    Reading,
    Traits,
    build_estimate,
    clip_expected_reading,
)
from undeadzone.nonlinearities.sensor import Zone, deadzone, jump, present
from undeadzone.numerics.clip import clip
from undeadzone.observers.adaptive.adaptation_laws import read_initial_widths
from undeadzone.plants.system import System
from undeadzone.util.arrays import Array, Floats, require_nonnegative


class Widths(NamedTuple):
    """Initial widths, their bound, and their adaptation gain.

    Attributes:
        gamma: adaptation gain (p) [1/s].
        start: d^(0), [right, left] per output (p x 2) [z].
        limit: upper bound d_M (p) [z].
    """

    gamma: Floats
    start: Floats
    limit: Floats


class Params(NamedTuple):
    """Parameters of the observer.

    L, gamma and the injection's numbers are per step if sampled.

    Attributes:
        model: numbers of the model.
        L: gain of the error (n x p).
        gamma: adaptation gain (p).
        law: numbers of the injection.
        right0, left0: widths at first (p) [z].
        limit: upper bound of the widths (p) [z].
        slope: slope m of the sensor (p).
    """

    model: Any
    L: Floats
    gamma: Floats
    law: Any
    right0: Floats
    left0: Floats
    limit: Floats
    slope: Floats


class State(NamedTuple):
    """State: x^ and the widths d_r^, d_l^."""

    x: Any
    right: Any
    left: Any


def read_adapted_widths(
    gamma: Array, widths0: Array, width_max: Array | None, model: System, sensor: Zone
) -> Widths:
    """Return checked initial widths, bound and adaptation gain. Raises InputError, ShapeError."""
    gain = require_nonnegative("observer.gamma", gamma, model.p, "one per output")
    if sensor.kind == "jump" and gain.any():
        raise InputError(
            "observer.gamma: readings of a jump sensor only bound its widths, this method cannot "
            "adapt them. Leave gamma out"
        )
    return Widths(gain, *read_initial_widths(widths0, width_max, model.p))


def active_branches(law: Any, s: State, z: Any, reading: Reading) -> tuple[Any, Any]:
    """Return 1 if a reading is on the right branch, and 1 if on the left branch (p each)."""
    return reading.side > 0, reading.side < 0


def no_injection(law: Any, e: Any) -> Any:
    """Return 0: no injection beside L e."""
    return 0.0


def build_output_error_observer(
    model: System,
    sensor: Zone,
    L: Floats,
    widths: Widths,
    law: Any = (),
    inject: Callable[[Any, Any], Any] = no_injection,
    adapted_sides: Callable[[Any, State, Any, Reading], tuple[Any, Any]] = active_branches,
) -> Observer:
    """Build the observer x^' = A x^ + B u + L e + inject(law, e), with widths that e adapts.

    The output error is e = y / m - Dz(C x^, d^) (p), 0 if the reading is missing. The widths obey
    d_r^' = -gamma e on the right branch and d_l^' = gamma e on the left one, within [0, d_M]. With
    x^ = x, e is d_r^ - d_r on the right and d_l - d_l^ on the left, so that widths approach theirs.

    Args:
        model: the model, continuous or sampled.
        sensor: the dead zone.
        L: gain (n x p), per step when the model is sampled.
        widths: how the widths adapt.
        law: numbers of the injection.
        inject: inject(law, e) is added to x^', per step when the model is sampled.
        adapted_sides: adapted_sides(law, state, C x^, reading) returns the weights with which the
            right and the left widths are adapted (p each, 0 to 1).
    """
    params = Params(
        model=model.params,
        L=L,
        gamma=widths.gamma * model.per_step,
        law=law,
        right0=widths.start[:, 0],
        left0=widths.start[:, 1],
        limit=widths.limit,
        slope=sensor.slope,
    )

    def init(p: Params) -> State:
        """Return the state at t = 0: x^ = 0 and the initial widths."""
        return State(np.zeros(model.n), p.right0, p.left0)

    def step(p: Params, s: State, u: Any, reading: Reading) -> tuple[State, Estimate]:
        """Return the state's derivative, or its next value if sampled, and the estimate."""
        z = model.output(p.model, s.x)
        e = zone_output_error(sensor, p, s, z, reading)
        right, left = adapted_sides(p.law, s, z, reading)
        after = State(
            model.move_with_correction(p.model, s.x, u, p.L @ e + inject(p.law, e)),
            model.keep * s.right - p.gamma * e * right,
            model.keep * s.left + p.gamma * e * left,
        )
        if model.Ts is not None:
            after = project_widths(p, after)
        return after, build_estimate(s.x, z, s.right, s.left, reading, p.slope, sensor.kind, e)

    adapts = bool(widths.gamma.any())
    traits = Traits(L=L, gamma=params.gamma, width_max=widths.limit, adapts=adapts)
    return Observer(params, init, step, project_widths, traits)


def zone_output_error(sensor: Zone, p: Params, s: State, z: Any, reading: Reading) -> Any:
    """Return the output error e = y / m - Dz(z, d^) (p) [z].

    The value is 0 for a missing reading, or for a limit that Dz exceeds.
    """
    zone = jump if sensor.kind == "jump" else deadzone
    expected = zone(z, s.right, s.left)
    y = reading.y / p.slope
    if sensor.limits is not None:
        expected = clip_expected_reading(expected, y, reading.side)
    return ca.if_else(present(reading.y), y - expected, 0.0)


def project_widths(p: Params, s: State) -> State:
    """Return the state with its widths clipped to [0, d_M]."""
    right = clip(s.right, 0.0, p.limit)
    left = clip(s.left, 0.0, p.limit)
    return State(s.x, right, left)
