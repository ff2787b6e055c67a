"""A motor that drives a load through a gap, in stiff contact, with friction on the load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats

TS, GAIN, TAU = 5e-3, 100.0, 0.1  # sample time [s], of the motor z'' = GAIN u - z' / TAU
TURN = np.pi**2  # deceleration of r = sin(pi t) at a turn [1/s^2]
FINE = 50  # steps of the integration in a sample
STIFF, DAMPING = 3000.0, 10.0  # of the contact [1/s^2], [1/s]
NOISE = 1e-3  # of the readings, rms


class Log(NamedTuple):
    """Readings of two masses with a gap between: times, y, u, and the true gap."""

    t: Floats
    y: Floats
    u: Floats
    gap: float


def two_masses(inertia: float, friction: float, seed: int) -> Log:
    """A motor and a load with Coulomb friction behind a gap, in stiff contact.

    Args:
        inertia: of the load [u s^2/z].
        friction: of the load [u].
        seed: of gap and noise.
    """
    rng = np.random.default_rng(seed)
    right, left = rng.uniform(0.02, 0.1, 2)
    J, f, h = inertia * GAIN, friction * GAIN, TS / FINE
    z = v = y = w = 0.0
    count = 2400
    t = np.arange(count) * TS
    readings, inputs = np.empty(count), np.empty(count)
    for k in range(count):
        readings[k] = y + NOISE * rng.standard_normal()
        phase, middle = np.pi * t[k], np.pi * (t[k] + TS / 2)
        u = (-(np.pi**2) * np.sin(middle) + np.pi * np.cos(middle) / TAU) / GAIN
        u -= (400.0 * (z - np.sin(phase)) + 30.0 * (v - np.pi * np.cos(phase))) / GAIN
        inputs[k] = u
        for _ in range(FINE):
            apart = z - y
            pressed = max(apart - right, 0.0) + min(apart + left, 0.0)
            force = STIFF * pressed + DAMPING * (v - w) * (pressed != 0)
            force = force if force * pressed > 0 else 0.0  # no contact pulls
            v += h * (-v / TAU + GAIN * u - force)
            w += h * force / J
            w = np.sign(w) * max(abs(w) - h * f / J, 0.0)
            z, y = z + h * v, y + h * w
    return Log(t, readings[:, None], inputs[:, None], right + left)
