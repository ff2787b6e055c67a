"""Logs of random plants behind a dead zone or another map, with their truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import cont2discrete, lfilter

from benchmarks.identify.logs.strangers import dragged, noisy, zone
from undeadzone.util.arrays import Floats

SAMPLES = 1500
DISTURBED = {"coloured": 0.1, "strong": 0.3}  # rms at z of a disturbance of the input
FAMILIES = (
    "white",
    "coloured",
    "strong",
    "sines",
    "one",
    "behind",
    "drift",
    "heavy",
    "jumps",
    "late",
    "motor",
    "none",
)
OPTIONS = {"jumps": {"kind": "jump"}, "motor": {"integrators": 1}}
MAPS = ("saturation", "jump", "cubic", "play")


class Log(NamedTuple):
    """A log and its truth: step [s], u, y, order, d_r, d_l; z is scaled to rms 1."""

    step: float
    u: Floats
    y: Floats
    n: int
    right: float
    left: float


def plant(rng: np.random.Generator) -> tuple[Floats, Floats, float, float, int]:
    """A sampled plant of order 1 to 3: numerator, denominator, step, natural frequency, order."""
    n = int(rng.integers(1, 4))
    omega = 2 * np.pi * rng.uniform(0.5, 1.5)
    damping = rng.uniform(0.2, 0.9)
    if n == 1:
        num, den = [omega], [1, omega]
    elif n == 2:
        num, den = [omega**2], [1, 2 * damping * omega, omega**2]
    else:
        fast = omega * rng.uniform(0.7, 3)
        num = [omega**2 * fast]
        den = np.polymul([1, 2 * damping * omega, omega**2], [1, fast])
    step = 2 * np.pi / omega / rng.uniform(15, 40)
    b, a, _ = cont2discrete((num, den), step)
    return b.ravel(), a, step, omega, n


def excitation(
    rng: np.random.Generator, step: float, omega: float, sines: bool, samples: int = SAMPLES
) -> Floats:
    """First-order noise, steps, or two to four sines."""
    time_ = np.arange(samples) * step
    if sines:
        count = int(rng.integers(2, 5))
        u = np.zeros(samples)
        for factor in (0.21, 0.47, 0.83, 1.31)[:count]:
            phase = rng.uniform(0, 6.3)
            u += rng.uniform(0.5, 1) * np.sin(omega * factor * time_ + phase)
        return u
    if rng.random() < 0.5:
        pole = math.exp(-step * omega * rng.uniform(0.3, 1))
        return lfilter([1], [1, -pole], rng.standard_normal(samples))
    hold = max(2, int(rng.uniform(0.5, 2) * 2 * np.pi / omega / step))
    return np.repeat(rng.standard_normal(samples // hold + 1), hold)[:samples]


def make(seed: int, family: str, samples: int = SAMPLES) -> Log:
    """A log of a family; a motor's has `SAMPLES`."""
    rng = np.random.default_rng(90_000 + seed)
    if family == "motor":
        return motor(rng)
    b, a, step, omega, n = plant(rng)
    u = excitation(rng, step, omega, family == "sines", samples)
    z = lfilter(b, a, u)
    if family == "late":
        late = int(rng.integers(1, 9))
        z = np.concatenate([np.zeros(late), z[:-late]])
    u, z = u / z.std(), z / z.std()
    right, left = rng.uniform(0.1, 1.0, 2)
    if family == "one":
        left = -float(np.quantile(z, 0.03)) * rng.uniform(0.8, 1)
    s = float(rng.choice([0.02, 0.05, 0.1]))
    e = s * rng.standard_normal(samples)
    if family == "heavy":
        e = 0.08 / math.sqrt(3) * rng.standard_t(3, samples)
    w = disturbance(rng, family, (b, a), step, omega, samples)
    if family == "none":
        return Log(step, u, z + e, n, 0.0, 0.0)
    if family == "behind":
        return Log(step, u, zone(z + w, right, left) + e, n, right, left)
    if family == "jumps":
        z = z + e
        return Log(step, u, z * ((z > right) | (z < -left)), n, right, left)
    return Log(step, u, zone(z + w + e, right, left), n, right, left)


def motor(rng: np.random.Generator) -> Log:
    """The position of a motor in a loop that keeps it near 0, in its own rms, disturbed."""
    step, lag = 0.02, rng.uniform(0.1, 0.4)
    num, den, _ = cont2discrete(([1.0], [lag, 1.0, 0.0]), step)
    b, a = num.ravel(), den
    hold = int(rng.uniform(10, 40))
    set_points = np.repeat(rng.standard_normal(SAMPLES // hold + 1), hold)[:SAMPLES]
    w = rng.uniform(0.0, 0.1) * lfilter([0.3], [1, -0.95], rng.standard_normal(SAMPLES))
    u, z = np.zeros(SAMPLES), np.zeros(SAMPLES)
    z[:2] = rng.uniform(-0.5, 0.5)
    for k in range(SAMPLES):
        if k > 1:
            driven = u[[k - 1, k - 2]] + w[[k - 1, k - 2]]
            z[k] = -a[1] * z[k - 1] - a[2] * z[k - 2] + b[1:] @ driven
        u[k] = 3 * set_points[k] - 2 * z[k]
    u, z = u / z.std(), z / z.std()
    right, left = rng.uniform(0.1, 0.8, 2)
    e = float(rng.choice([0.02, 0.05])) * rng.standard_normal(SAMPLES)
    return Log(step, u, zone(z + e, right, left), 2, right, left)


def disturbance(
    rng: np.random.Generator,
    family: str,
    plant: tuple[Floats, Floats],
    step: float,
    omega: float,
    samples: int,
) -> Floats:
    """What is added to z ahead of the zone besides white noise."""
    if family in DISTURBED:
        pole = math.exp(-step * omega / rng.uniform(0.3, 2))
        w = lfilter(*plant, lfilter([1], [1, -pole], rng.standard_normal(samples + 500)))[500:]
        return w / w.std() * DISTURBED[family]
    if family == "drift":
        pole = math.exp(-step * omega / 20)
        w = lfilter([1], [1, -pole], rng.standard_normal(samples + 3000))[3000:]
        return w / w.std() * 0.15
    return np.zeros(samples)


def mapped(seed: int, kind: str) -> Log:
    """A log of another map than a dead zone."""
    log = make(seed, "none")
    rng = np.random.default_rng(seed)
    z = log.y
    if kind == "saturation":
        y = np.clip(z, -0.8, 1.0)
    elif kind == "jump":
        y = np.where((z > 0.4) | (z < -0.7), z, 0.0)
    elif kind == "cubic":
        y = z + 0.5 * z**3
    else:
        y = noisy(rng, dragged(z, 0.8, 0.0), 0.03)
    return log._replace(y=y)
