"""Logs with a dead zone, a play, both or neither, and their truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from benchmarks.identify.logs.random_plants import excitation, plant
from undeadzone.util.arrays import Floats

KINDS = ("neither", "dead_zone", "play", "both")
WHERE = (*KINDS, "input_zone")
LENGTH = 1500  # samples of a log whose plant is not known


class Open(NamedTuple):
    """A log without a loop: step [s], u, y, c_r + c_l, and d_r + d_l of the sensor or input."""

    step: float
    u: Floats
    y: Floats
    widths: Floats


def through(v: Floats, c: Floats, d: Floats) -> Floats:
    """What a play c and a dead zone d after it read of v (N)."""
    y, now = np.empty(v.size), 0.0
    for k, value in enumerate(v.tolist()):
        now = max(min(now, value + c[1]), value - c[0])
        y[k] = now
    return np.maximum(y - d[0], 0.0) + np.minimum(y + d[1], 0.0)


FAMILIES = {"noise": 0.0, "disturbed": 0.1, "encoder": 0.05}  # rms of the disturbance at z
QUANTUM = 0.05


def open_log(kind: str, family: str, seed: int) -> Open:
    """A random plant of order 1 to 3, z of rms 1, gaps of 0.1 to 0.8, zones of 0.15 to 0.6 a side.

    Noise of rms 0.01 to 0.06 behind everything, or an encoder; a disturbance of the input.
    """
    rng = np.random.default_rng(5000 + seed)
    b, a, step, omega, _ = plant(rng)
    u = excitation(rng, step, omega, False)
    z = lfilter(b, a, u)
    u, z = u[:LENGTH] / z.std(), z[:LENGTH] / z.std()
    c, d = rng.uniform(0.1, 0.8, 2), rng.uniform(0.15, 0.6, 2)
    if kind == "input_zone":
        d = d * u.std()
        z = lfilter(b, a, np.maximum(u - d[0], 0.0) + np.minimum(u + d[1], 0.0))
        b, z = b / z.std(), z / z.std()
    pole = math.exp(-step * omega / rng.uniform(0.3, 2))
    w = lfilter(b, a, lfilter([1], [1, -pole], rng.standard_normal(LENGTH + 500)))[500:]
    z = z + FAMILIES[family] * w / w.std()
    noise = float(rng.choice([0.01, 0.03, 0.06]))
    c = c * (kind in ("play", "both"))
    y = through(z, c, d * (kind in ("dead_zone", "both")))
    e = noise * rng.standard_normal(LENGTH)
    y = QUANTUM * np.round(y / QUANTUM) if family == "encoder" else y + e
    d = d * (kind in ("dead_zone", "both", "input_zone"))
    return Open(step, u, y, np.array([c.sum(), d.sum()]))
