"""Logs of closed loops with a zone of the actuator, of both ends or a play, and a reference."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from benchmarks.identify.logs.names import draw_reference, random_plant, through_zone
from undeadzone.util.arrays import Floats

KINDS = ("input zone", "play", "both ends")
SHORTEST, LONGEST = 700, 5000  # samples
LARGEST = 30.0  # input of a loop that holds


class LoopLog(NamedTuple):
    """A log and its truth.

    Attributes:
        step: [s].
        u, y, r: input, reading and reference (N).
        order: of the plant.
        input, sensor: widths of the zones, right and left, 0 where there is none.
        gaps: of the play, right and left, 0 where there is none.
        closed: whether u answers to y.
    """

    step: float
    u: Floats
    y: Floats
    r: Floats
    order: int
    input: Floats
    sensor: Floats
    gaps: Floats
    closed: bool


def make(seed: int, kind: str, disturbance: float, closed: bool = True) -> LoopLog:
    """A loop on y with proportional and integral part; everything but the disturbance is drawn.

    Args:
        seed: of the draws; a loop that does not hold is drawn again.
        kind: of `KINDS`.
        disturbance: rms of first-order noise at the plant's input.
        closed: whether u answers to y.
    """
    rng = np.random.default_rng(900_000 + 100 * seed + KINDS.index(kind))
    while True:
        log = _drawn(rng, kind, disturbance, closed)
        if np.abs(log.u).max() < LARGEST:
            return log


def _drawn(rng: np.random.Generator, kind: str, disturbance: float, closed: bool) -> LoopLog:
    """A log, which may run away."""
    plant = random_plant(rng)
    size = int(math.exp(rng.uniform(math.log(SHORTEST), math.log(LONGEST))))
    r = draw_reference(rng, plant, size)
    zone = rng.uniform(0.15, 0.6, 2) * (kind != "play")
    sensor = rng.uniform(0.15, 0.6, 2) * (kind == "both ends")
    gaps = rng.uniform(0.1, 0.5, 2) * (kind == "play")
    ahead = kind == "both ends" and rng.random() < 0.5  # noise is silent in the sensor's zone
    e = float(rng.choice([0.01, 0.03, 0.05])) * rng.standard_normal(size)
    pole = math.exp(-plant.step * plant.omega / rng.uniform(0.3, 2.0))
    w = lfilter([1.0], [1.0, -pole], rng.standard_normal(size))
    w *= disturbance / w.std()
    proportional, integral = closed * rng.uniform(0.3, 2.0), closed * rng.uniform(0.1, 0.6)
    u, y, x = np.zeros(size), np.zeros(size), np.zeros(plant.G.size)
    total = z = level = 0.0
    for k in range(size):
        level = min(max(level, z - gaps[0]), z + gaps[1])
        y[k] = through_zone(level + ahead * e[k], *sensor) + (not ahead) * e[k]
        total += integral * plant.omega * plant.step * (r[k] - y[k])
        u[k] = r[k] + proportional * (r[k] - y[k]) + total
        if abs(u[k]) > LARGEST:
            break
        x = plant.F @ x + plant.G * (through_zone(u[k], *zone) + w[k])
        z = float(plant.C @ x)
    return LoopLog(plant.step, u, y, r, plant.G.size, zone, sensor, gaps, closed)
