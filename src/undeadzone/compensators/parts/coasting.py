"""Coasting: brief intervals of u = 0 that separate the actuator's widths from the sensor's.

A perfect inverse never lets the actuator fall silent, and then one combination of the four widths
cannot be seen (docs/actuator.md). So coast when the output is well visible and the widths are not
yet known. The inverse, and which widths it uses, stands here too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.interfaces import Compensator, Estimate, Reading
from undeadzone.nonlinearities.actuator import Belief, Drive
from undeadzone.plants.system import System
from undeadzone.registry import Options
from undeadzone.util.arrays import Floats, require_number

VISIBLE = 0.25  # share of the largest reading of late from which an output is well visible
FORGET = 0.2  # share of the largest reading that is forgotten from one coast to the next


class Coasts(Options, frozen=True, kw_only=True):
    """Options of coasting, sampled time only.

    Attributes:
        coast: length of a coast [s] (0: it never coasts).
        every: least time from one coast to the next [s].
        until: time after which it coasts no more [s] (default: none).
        tolerance: no coast if the deviations of both widths are below this share of the largest
            width.
    """

    coast: float = 0.0
    every: float = 2.0
    until: float | None = None
    tolerance: float = 0.002


class Numbers(NamedTuple):
    """Parameters of coasting, times in steps.

    Attributes:
        coast, every, until: as in `Coasts` (1).
        tolerance: of the deviations of the widths, as a share of the widths (1).
        forget: factor of the largest reading per step (1).
    """

    coast: Any
    every: Any
    until: Any
    tolerance: Any
    forget: Any


class State(NamedTuple):
    """Steps left of a coast, steps until the next, steps so far, and the largest reading (p)."""

    left: Any
    idle: Any
    count: Any
    peak: Any


def start_coasting(options: Coasts, model: System) -> tuple[Numbers | None, State | None]:
    """Return parameters and first state of coasting, or None if coasting is off.

    Raises:
        InputError: for times that cannot be, or in continuous time.
    """
    length = require_number("compensator.coast", options.coast, least=0.0)
    every = require_number("compensator.every", options.every, above=0.0)
    tolerance = require_number("compensator.tolerance", options.tolerance, least=0.0)
    until = np.inf
    if options.until is not None:
        until = require_number("compensator.until", options.until, least=0.0)
    if not length:
        return None, None
    if model.Ts is None:
        raise InputError('compensator.coast: needs samples. Set simulation.time = "sampled"')
    if length >= every:
        raise InputError(
            f"compensator.coast: must be shorter than compensator.every, {every:g} s, found "
            f"{length:g} s"
        )
    pause = every / model.Ts
    numbers = Numbers(
        coast=np.array([length / model.Ts]),
        every=np.array([pause]),
        until=np.array([min(until, 1e9) / model.Ts]),
        tolerance=np.array([tolerance]),
        forget=np.array([(1 - FORGET) ** (1 / pause)]),
    )
    none = np.zeros(1)
    return numbers, State(none, numbers.every / 2, none, np.zeros(model.p))


def apply_coasting(
    q: Numbers | None, s: State | None, u: Any, estimate: Estimate, reading: Reading
) -> tuple[State | None, Any]:
    """Return (the next state, the input: u, or 0 during a coast).

    A coast begins if all outputs are active and near their peaks, a width is uncertain, and the
    time `every` has passed since the last one.

    Args:
        q: the numbers (None: it never coasts).
        s: the state.
        u: input that the compensator computes (m).
        estimate: of the observer, with the widths and their deviations.
        reading: of the sensor.
    """
    if q is None or s is None:
        return s, u
    active = ca.fabs(reading.side) == 1
    size = ca.if_else(active, ca.fabs(reading.y), 0.0)
    peak = ca.fmax(q.forget * s.peak, size)
    visible = ca.mmin(ca.logic_and(active, size > VISIBLE * peak)) > 0
    unsure = 1.0
    if estimate.actuator_right_std.shape[0]:
        widths = ca.vertcat(estimate.actuator_right, estimate.actuator_left)
        stds = ca.vertcat(estimate.actuator_right_std, estimate.actuator_left_std)
        unsure = ca.mmax(stds) > q.tolerance * ca.mmax(widths)
    ready = ca.logic_and(s.left <= 0, ca.logic_and(s.idle <= 0, s.count < q.until))
    begins = ca.logic_and(ready, ca.logic_and(visible, unsure))
    left = ca.if_else(begins, q.coast, s.left - 1)
    idle = ca.if_else(begins, q.every, s.idle - 1)
    return State(left, idle, s.count + 1, peak), ca.if_else(left > 0, 0.0, u)


def require_drive(belief: Belief | None) -> Drive:
    """Return the model's actuator. Raises InputError if the model has none."""
    if belief is None:
        raise InputError(
            "compensator: there is no actuator to compensate. Add [actuator] or [model.actuator]"
        )
    if belief.drive.is_play:
        raise InputError(
            "compensator.method: this inverse is of a dead zone, and the actuator has play. Use "
            "'play_inverse' or 'none'"
        )
    return belief.drive


def actuator_widths(drive: Drive, estimate: Estimate) -> tuple[Any, Any]:
    """Return the widths (b_r^, b_l^) (m each) [u].

    They are the observer's estimates, or the model's widths without estimates.
    """
    if estimate.actuator_right_std.shape[0]:
        return estimate.actuator_right, estimate.actuator_left
    return drive.right, drive.left


class ZoneInverseNumbers(NamedTuple):
    """Parameters of an inverse.

    Attributes:
        drive: the believed actuator.
        soft: |v| over which its step is spread (m) [u] (None: it jumps).
        coasts: numbers of coasting.
    """

    drive: Drive
    soft: Floats | None
    coasts: Numbers | None


def build_zone_inverse(
    options: Coasts, model: System, drive: Drive, soft: Floats | None = None
) -> Compensator:
    """Return the inverse of the model's actuator, with coasting.

    Args:
        options: of coasting.
        model: the model.
        drive: the believed actuator.
        soft: |v| from which the whole width is added (m) [u] (None: 0).
    """
    numbers, first = start_coasting(options, model)

    def step(q: ZoneInverseNumbers, s: Any, v: Any, estimate: Estimate, reading: Reading) -> Any:
        """Return the next state, and the command u (m)."""
        right, left = actuator_widths(q.drive, estimate)
        part = 1.0 if q.soft is None else ca.fmin(ca.fabs(v) / q.soft, 1.0)
        u = invert_actuator(q.drive, v, part * right, part * left)
        return apply_coasting(q.coasts, s, u, estimate, reading)

    return Compensator(ZoneInverseNumbers(drive, soft, numbers), lambda q: first, step)


def invert_actuator(drive: Drive, v: Any, right: Any, left: Any) -> Any:
    """Return the command u (m) [u] with plant input v: v / m_r + b_r, v / m_l - b_l, or 0.

    Args:
        drive: the believed actuator, for its slopes.
        v: what shall enter (m).
        right, left: b_r, b_l, or the part of them that is added (m) [u].
    """
    u = ca.if_else(v > 0, v / drive.slope_right + right, 0.0)
    return u + ca.if_else(v < 0, v / drive.slope_left - left, 0.0)
