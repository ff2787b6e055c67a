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
    """Return the overrun number J a / f of each output (p) [1].

    An entry is None if its output is not tracked, or if its reference has corners, at which a is
    unbounded. The result is None if no sensor has a load with inertia.

    Args:
        sensor: the sensor, with inertia J and friction f of its loads.
        reference: references of the tracked outputs.
        tracked: indices of the tracked outputs.
        duration: duration of the run [s].
        step: time between samples [s].
    """
    if not sensor.inertia.any():
        return None
    numbers: list[float | None] = [None] * sensor.inertia.size
    largest = decelerations(reference, duration, step)
    for i, deceleration in zip(tracked, largest, strict=True):
        if np.isfinite(deceleration):
            numbers[i] = float(sensor.inertia[i] * deceleration / sensor.friction[i])
    return numbers


def decelerations(reference: Exosystem, duration: float, step: float) -> Floats:
    """Return the largest deceleration of each signal [1/s^2], nan if it has corners.

    Args:
        reference: the signals.
        duration: end of the time from 0 that is sampled [s].
        step: step of the finite differences [s].
    """
    r = reference.output_at(np.arange(0.0, duration + step / 2, step))
    # Differences over one and two steps agree for a smooth signal and differ by 2 at a corner.
    fine = _largest_deceleration(r, step)
    coarse = _largest_deceleration(r[::2], 2 * step)
    return np.where(fine <= SMOOTH * coarse, fine, np.nan)


def _largest_deceleration(r: Floats, step: float) -> Floats:
    """Return the largest deceleration of each column of samples r (N x p) taken every step [s]."""
    speed = np.diff(r, axis=0) / step
    acceleration = np.diff(r, 2, axis=0) / step**2
    before = np.sign(speed[:-1])
    after = np.sign(speed[1:])
    deceleration = np.maximum(-acceleration * before, -acceleration * after)
    return np.asarray(deceleration.max(axis=0, initial=0.0))


def overrun_along(sensor: Zone, flow: Matrices, x: Floats, u: Floats) -> Floats:
    """Return the overrun number J a / f of each output at each sample of a run (N x p) [1].

    Args:
        sensor: the sensor, with inertia J and friction f of its loads; f > 0 if J > 0.
        flow: the plant's matrices in continuous time.
        x: states (N x n).
        u: inputs (N x m).
    """
    x_rate = x @ flow.A.T + u @ flow.B.T
    # z' = C x' and, with u constant between samples, z'' = C A x'.
    speed = x_rate @ flow.C.T
    acceleration = x_rate @ (flow.C @ flow.A).T
    deceleration = np.maximum(-acceleration * np.sign(speed), 0.0)
    loaded = sensor.inertia > 0
    return np.asarray(
        deceleration
        * np.where(loaded, sensor.inertia, 0.0)
        / np.where(loaded, sensor.friction, 1.0)
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
                "with inertia behind gears is two masses: plant.arm.gears (docs/robot_gears.md)"
            )
