"""Logs of random plants behind a dead zone or another map, with their truth."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import cont2discrete, lfilter

from undeadzone.support.arrays import Floats

SAMPLES = 1500
DISTURBED = {"coloured": 0.1, "strong": 0.3}  # rms at z of a disturbance of the input
FAMILIES = ("white", "coloured", "strong", "sines", "one", "behind", "drift", "heavy", "none")
MAPS = ("saturation", "jump", "cubic", "play")


class Made(NamedTuple):
    """A log and its truth: step [s], u, y, order, d_r, d_l; z is scaled to rms 1."""

    step: float
    u: Floats
    y: Floats
    n: int
    right: float
    left: float


def dead_zone(z: Floats, right: float, left: float) -> Floats:
    return np.maximum(z - right, 0.0) + np.minimum(z + left, 0.0)


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


def excitation(rng: np.random.Generator, step: float, omega: float, sines: bool) -> Floats:
    """First-order noise, steps, or two to four sines."""
    time_ = np.arange(SAMPLES) * step
    if sines:
        count = int(rng.integers(2, 5))
        u = np.zeros(SAMPLES)
        for factor in (0.21, 0.47, 0.83, 1.31)[:count]:
            phase = rng.uniform(0, 6.3)
            u += rng.uniform(0.5, 1) * np.sin(omega * factor * time_ + phase)
        return u
    if rng.random() < 0.5:
        pole = math.exp(-step * omega * rng.uniform(0.3, 1))
        return lfilter([1], [1, -pole], rng.standard_normal(SAMPLES))
    hold = max(2, int(rng.uniform(0.5, 2) * 2 * np.pi / omega / step))
    return np.repeat(rng.standard_normal(SAMPLES // hold + 1), hold)[:SAMPLES]


def make(seed: int, family: str) -> Made:
    """A log of a family."""
    rng = np.random.default_rng(90_000 + seed)
    b, a, step, omega, n = plant(rng)
    u = excitation(rng, step, omega, family == "sines")
    z = lfilter(b, a, u)
    u, z = u / z.std(), z / z.std()
    right, left = rng.uniform(0.1, 1.0, 2)
    if family == "one":
        left = -float(np.quantile(z, 0.03)) * rng.uniform(0.8, 1)
    s = float(rng.choice([0.02, 0.05, 0.1]))
    e = s * rng.standard_normal(SAMPLES)
    if family == "heavy":
        e = 0.08 / math.sqrt(3) * rng.standard_t(3, SAMPLES)
    w = disturbance(rng, family, b, a, step, omega)
    if family == "none":
        return Made(step, u, z + e, n, 0.0, 0.0)
    if family == "behind":
        return Made(step, u, dead_zone(z + w, right, left) + e, n, right, left)
    return Made(step, u, dead_zone(z + w + e, right, left), n, right, left)


def disturbance(
    rng: np.random.Generator, family: str, b: Floats, a: Floats, step: float, omega: float
) -> Floats:
    """What is added to z ahead of the zone besides white noise."""
    if family in DISTURBED:
        pole = math.exp(-step * omega / rng.uniform(0.3, 2))
        w = lfilter(b, a, lfilter([1], [1, -pole], rng.standard_normal(SAMPLES + 500)))[500:]
        return w / w.std() * DISTURBED[family]
    if family == "drift":
        pole = math.exp(-step * omega / 20)
        w = lfilter([1], [1, -pole], rng.standard_normal(SAMPLES + 3000))[3000:]
        return w / w.std() * 0.15
    return np.zeros(SAMPLES)


def mapped(seed: int, kind: str) -> Made:
    """A log of another map than a dead zone."""
    made = make(seed, "none")
    rng = np.random.default_rng(seed)
    z = made.y
    if kind == "saturation":
        y = np.clip(z, -0.8, 1.0)
    elif kind == "jump":
        y = np.where((z > 0.4) | (z < -0.7), z, 0.0)
    elif kind == "cubic":
        y = z + 0.5 * z**3
    else:
        y, now = np.empty(z.size), 0.0
        for k, value in enumerate(z):
            now = min(max(now, value - 0.4), value + 0.4)
            y[k] = now
        y += 0.03 * rng.standard_normal(z.size)
    return made._replace(y=y)
