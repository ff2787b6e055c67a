"""Logs of ten truths, in open and in closed loop, with noise, rounded or not, or an encoder."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.signal import cont2discrete, lfilter

from undeadzone.util.arrays import Floats

# What is there, and the word of `identify` for it.
TRUTHS = {
    "none": "none",
    "operating point": "operating_point",
    "sensor": "dead_zone",
    "input": "input_zone",
    "sensor and input": "two_zones",
    "friction": "friction",
    "play": "play",
    "play and zone": "both",
    "saturation": "saturation",
    "cubic": "other",
}
SHORTEST, LONGEST = 200, 20_000  # samples
CUBIC = 4.0  # of z, beyond which a cubic sensor goes on in parallel to the identity
SUBSTEPS = 20  # of a step, in which friction is simulated
PROPORTIONAL, INTEGRAL = 0.5, 0.2  # of the loop; the latter by the plant's natural frequency
STEPS = (0.0, 0.3, 1.0, 3.0)  # of a converter, in rms of the noise
ROUNDED = 20_000  # first seed whose noisy readings a converter rounds
ZONED = ("sensor", "sensor and input", "play and zone")
DRIVEN = ("input", "sensor and input")
OF_ONE = ("sensor", "input", "friction", "play")  # truths of one element, whose widths are asked


class NamedLog(NamedTuple):
    """A log and its truth.

    Attributes:
        step: [s].
        u, y: input and reading (N).
        truth: what is there, of `TRUTHS`.
        closed: whether u answers to y.
        encoder: whether readings are rounded, and not noisy; else they may be both.
        widths: of the sensor's zone, of the play or of the input's zone, right and left, or the
            level of friction; where there is none, 0.
    """

    step: float
    u: Floats
    y: Floats
    truth: str
    closed: bool
    encoder: bool
    widths: tuple[float, float]


class Plant(NamedTuple):
    """A sampled plant in state space (F, G, C), step [s] and natural frequency [rad/s]."""

    F: Floats
    G: Floats
    C: Floats
    step: float
    omega: float


def through_zone(z: float, right: float, left: float) -> float:
    """Dz(z)."""
    return max(z - right, 0.0) + min(z + left, 0.0)


def random_plant(rng: np.random.Generator) -> Plant:
    """A stable plant of order 1 to 3 and gain 1, 15 to 40 samples a period."""
    n = int(rng.integers(1, 4))
    omega = 2 * np.pi * rng.uniform(0.5, 1.5)
    poles = np.array([1.0])
    if n > 1:
        poles = np.polymul(poles, [1 / omega**2, 2 * rng.uniform(0.3, 0.9) / omega, 1.0])
    if n != 2:
        poles = np.polymul(poles, [1 / (omega * rng.uniform(0.7, 2.0)), 1.0])
    step = 2 * np.pi / omega / rng.uniform(15, 40)
    numerator, denominator, _ = cont2discrete(([1.0], poles), step)
    companion = np.eye(n, k=-1)
    companion[0] = -denominator[1:]
    return Plant(companion, np.eye(n)[0], numerator.ravel()[1:], step, omega)


def draw_reference(rng: np.random.Generator, plant: Plant, size: int) -> Floats:
    """A reference of rms 1: noise of first order, or steps."""
    if rng.random() < 0.5:
        pole = math.exp(-plant.step * plant.omega * rng.uniform(0.3, 1.0))
        r = lfilter([1.0], [1.0, -pole], rng.standard_normal(size))
    else:
        hold = max(2, int(rng.uniform(0.5, 2.0) * 2 * np.pi / plant.omega / plant.step))
        r = np.repeat(rng.standard_normal(size // hold + 1), hold)[:size]
    return np.asarray(r / r.std())


def make(seed: int, truth: str, may_close: bool = True) -> NamedLog:
    """A log of a truth; everything else is drawn.

    A loop on a cubic sensor may swing far beyond the range in which the sensor is cubic. That is
    another truth, so such a log is drawn again without the loop.

    Args:
        seed: of the draws.
        truth: of `TRUTHS`.
        may_close: whether the log may be of a closed loop.
    """
    rng = np.random.default_rng(700_000 + 100 * seed + list(TRUTHS).index(truth))
    plant = random_plant(rng)
    size = int(math.exp(rng.uniform(math.log(SHORTEST), math.log(LONGEST))))
    closed, encoder = bool(rng.random() < 0.5) and may_close, bool(rng.random() < 0.4)
    r = draw_reference(rng, plant, size)
    widths = rng.uniform(0.15, 0.6, 2)
    gaps = rng.uniform(0.1, 0.5, 2)
    noise = 0.0 if encoder else float(rng.choice([0.01, 0.03, 0.06]))
    ahead = truth in ZONED and rng.random() < 0.5  # noise is silent in the sensor's zone
    pole = math.exp(-plant.step * plant.omega / rng.uniform(0.3, 2.0))
    w = lfilter([1.0], [1.0, -pole], rng.standard_normal(size))
    w *= float(rng.choice([0.0, 0.1])) / w.std()  # disturbs the input
    e = noise * rng.standard_normal(size)
    moved = _mover(plant, truth, float(widths.mean()))
    read = _reader(truth, widths, gaps)
    level = rng.uniform(3.0, 6.0) * rng.choice([-1.0, 1.0])  # of an operating point
    passes = (lambda v: through_zone(v, *widths[::-1])) if truth in DRIVEN else (lambda v: v)
    step = 0.03 if encoder else noise * float(rng.choice(STEPS)) * (seed >= ROUNDED)
    u, y, total, z = np.empty(size), np.empty(size), 0.0, 0.0
    for k in range(size):
        y[k] = read(z + e[k]) if ahead else read(z) + e[k]
        if truth == "operating point":
            y[k] += level
        if step:
            y[k] = step * round(y[k] / step)
        u[k] = r[k]
        if closed:
            error = r[k] - (y[k] - level * (truth == "operating point"))
            total += INTEGRAL * plant.omega * plant.step * error
            u[k] = r[k] + PROPORTIONAL * error + total
        z = moved(passes(u[k]) + w[k])
        if truth == "cubic" and closed and abs(z) > CUBIC:
            return make(seed, truth, may_close=False)
    own = (
        gaps if truth in ("play", "play and zone") else widths[::-1] if truth in DRIVEN else widths
    )
    own = np.full(2, widths.mean()) if truth == "friction" else own
    own = own if truth in (*OF_ONE, "play and zone") else np.zeros(2)
    return NamedLog(plant.step, u, y, truth, closed, encoder, (float(own[0]), float(own[1])))


def _mover(plant: Plant, truth: str, force: float) -> Callable[[float], float]:
    """What makes the next z of an input: the plant, or a mass with friction."""
    if truth == "friction":
        return _rubbed(plant, force)
    x = np.zeros(plant.G.size)

    def moved(u: float) -> float:
        nonlocal x
        x = plant.F @ x + plant.G * u
        return float(plant.C @ x)

    return moved


def _rubbed(plant: Plant, force: float) -> Callable[[float], float]:
    """The speed of a mass with Coulomb friction."""
    h, v = plant.step / SUBSTEPS * plant.omega, 0.0

    def moved(u: float) -> float:
        nonlocal v
        for _ in range(SUBSTEPS):
            if v == 0.0:
                v = h * through_zone(u, force, force)
                continue
            following = v + h * (u - v - math.copysign(force, v))
            v = 0.0 if following * v < 0 else following
        return v

    return moved


def _reader(truth: str, widths: Floats, gaps: Floats) -> Callable[[float], float]:
    """What the sensor reads of z, without noise behind it."""
    level = 0.0

    def read(z: float) -> float:
        nonlocal level
        if truth in ("play", "play and zone"):
            level = min(max(level, z - gaps[0]), z + gaps[1])
            z = level
        if truth in ZONED:
            return through_zone(z, *widths)
        if truth == "saturation":
            return min(max(z, -1.2 * widths[0] - 0.2), 1.2 * widths[1] + 0.2)
        return z + 0.4 * min(max(z, -CUBIC), CUBIC) ** 3 if truth == "cubic" else z

    return read
