"""Loops and logs with a dead zone, a play, both or neither, and their truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from benchmarks.identify.logs.random_plants import excitation, plant
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.motion import MovingPlant

KINDS = ("neither", "dead_zone", "play", "both")
WHERE = (*KINDS, "input_zone")
STEP, SAMPLES = 0.01, 3000
NOISE, DISTURBANCE = 0.01, 0.5  # rms, of readings and at the input
AMPLITUDE, RATE = 5.0, 1.3  # of the reference, and in rad/s
LENGTH = 1500  # samples of a log whose plant is not known


class Loop(NamedTuple):
    """A log in a loop with its plant; c_r + c_l and d_r + d_l, 0 where there is none."""

    plant: MovingPlant
    u: Floats
    y: Floats
    widths: Floats


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


def closed_loop(kind: str, a0: float, seed: int) -> Loop:
    """z'' = -a0 z - 2 z' + u held on a sine by its true state; 0.2 to 1 a side."""
    rng = np.random.default_rng(seed)
    block = np.zeros((3, 3))
    block[:2, :2] = [[0.0, 1.0], [-a0, -2.0]]
    block[1, 2] = 1.0
    transition = expm(block * STEP)
    F, B = transition[:2, :2], transition[:2, 2]
    c, d = rng.uniform(0.2, 1.0, (2, 2))
    c, d = c * (kind in ("play", "both")), d * (kind in ("dead_zone", "both"))
    disturbance = DISTURBANCE * rng.standard_normal(SAMPLES)
    gain = np.array([36 - a0, 10.0])
    u, z, x = np.empty(SAMPLES), np.empty(SAMPLES), np.zeros(2)
    for k in range(SAMPLES):
        now, middle = RATE * k * STEP, RATE * (k + 0.5) * STEP
        r = AMPLITUDE * np.array([math.sin(now), RATE * math.cos(now)])
        ahead = (a0 - RATE**2) * math.sin(middle) + 2 * RATE * math.cos(middle)
        u[k], z[k] = AMPLITUDE * ahead - gain @ (x - r), x[0]
        x = F @ x + B * (u[k] + disturbance[k])
    y = through(z, c, d) + NOISE * rng.standard_normal(SAMPLES)
    noise = DISTURBANCE**2 * np.outer(B, B)
    model = MovingPlant(F, B[:, None], np.array([1.0, 0.0]), noise, 100 * np.eye(2), NOISE)
    return Loop(model, u[:, None], y, np.array([c.sum(), d.sum()]))


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
