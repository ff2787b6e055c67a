"""The overrun number J a / f, a test if a load behind a play stays at rest after a push.

J is the load's inertia, f its friction, a the largest deceleration of z. Friction stops the load
within a / (f / J) of the way that the motor takes to stop: below 1 the load rests against its
contact until it is pushed again, and the reading is that of a play. Above 1 it coasts through its
gap, y moves without contact, and no side can be determined (docs/play.md).
"""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.signals.exosystem import Exosystem
from undeadzone.util.arrays import Floats

SMOOTH = 1.3  # ratio of decelerations over one and two steps beyond which r has corners


def overrun_numbers(
    sensor: Zone, reference: Exosystem, tracked: list[int], duration: float, step: float
) -> list[float | None] | None:
    """Return J a / f of each output, or None if unknown, and for all if no inertia is given.

    It cannot of an output that is not tracked, and of a reference with corners.

    Args:
        sensor: the sensor.
        reference: of the tracked outputs.
        tracked: their numbers.
        duration: over which they follow it [s].
        step: time between samples [s].
    """
    if not sensor.inertia.any():
        return None
    numbers: list[float | None] = [None] * sensor.inertia.size
    along = decelerations(reference, duration, step)
    for i, most in zip(tracked, along, strict=True):
        if np.isfinite(most):
            numbers[i] = float(sensor.inertia[i] * most / sensor.friction[i])
    return numbers


def decelerations(reference: Exosystem, duration: float, step: float) -> Floats:
    """Return the largest deceleration of each signal [1/s^2], nan if it has corners.

    Args:
        reference: the signals.
        duration: over which they are looked at [s].
        step: over which they are differenced [s].
    """
    r = reference.output_at(np.arange(0.0, duration + step / 2, step))
    fine, coarse = _largest(r, step), _largest(r[::2], 2 * step)
    return np.where(fine <= SMOOTH * coarse, fine, np.nan)


def _largest(r: Floats, step: float) -> Floats:
    """Return the largest deceleration of each column of samples."""
    rate, bend = np.diff(r, axis=0) / step, np.diff(r, 2, axis=0) / step**2
    slowing = np.maximum(-bend * np.sign(rate[:-1]), -bend * np.sign(rate[1:]))
    return np.asarray(slowing.max(axis=0, initial=0.0))


def overrun_along(sensor: Zone, flow: Matrices, x: Floats, u: Floats) -> Floats:
    """Return J a / f of each output at instants of which state and input are known (N x p).

    Args:
        sensor: the sensor, with a load that has friction.
        flow: the plant's matrices in continuous time.
        x: states (N x n).
        u: inputs (N x m).
    """
    moving = x @ flow.A.T + u @ flow.B.T
    speed, bend = moving @ flow.C.T, moving @ (flow.C @ flow.A).T
    slowing = np.maximum(-bend * np.sign(speed), 0.0)
    loaded = sensor.inertia > 0
    return np.asarray(
        slowing * np.where(loaded, sensor.inertia, 0.0) / np.where(loaded, sensor.friction, 1.0)
    )


def require_contact(
    sensor: Zone, reference: Exosystem, tracked: list[int], duration: float, step: float
) -> None:
    """Raise InputError if a load would coast through its gap. Arguments of `overrun_numbers`."""
    for i, number in enumerate(overrun_numbers(sensor, reference, tracked, duration, step) or []):
        if number is not None and number > 1:
            stops = sensor.friction[i] / sensor.inertia[i]
            raise InputError(
                f"sensor.load_inertia: output {i} is out of reach for a play at the sensor: its "
                f"overrun number J a / f is {number:.3g}. Above 1 the load coasts through its gap "
                f"and y moves without contact. Slow the reference down until it decelerates by "
                f"less than f / J = {stops:.3g} 1/s^2, or measure ahead of the gap. A load "
                "with inertia behind gears is two masses: plant.arm.gears (docs/robots.md)"
            )
