"""Random plants with an output dead zone, their readings and what is true: problems for filters."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.signals import noise as noises
from undeadzone.util.arrays import Floats

STEP, DURATION, RAMP = 0.01, 10.0, 2.0  # [s]
RANGE = (0.3, 2.0)  # declared range of the widths, from which they are drawn evenly
CORRELATION = 0.2  # [s] of the disturbance
REACHES = ("both edges", "grazing", "right edge only", "no edge")


class World(NamedTuple):
    """What the problems of a family have besides noise, as rms.

    Attributes:
        disturbance: relative to the largest |u|
        bias: in z
        tolerance: relative error of the model
        late: step of the bias after half of the time, in z; none claims it
    """

    disturbance: float = 0.0
    bias: float = 0.0
    tolerance: float = 0.0
    late: float = 0.0


WORLDS = {"noise only": World(), "disturbed": World(0.05, 0.2, 0.05)}


class Problems(NamedTuple):
    """K problems of one order n: what is known of each, what it does, what is true in the end.

    Attributes:
        models: what a filter is told of the plants
        noise, disturbance, bias: rms of each (K)
        world: of this family
        x_std: rms of the initial state (K x n)
        u, y: inputs and readings (samples x K)
        x: the last state (K x n)
        d: the widths d_r, d_l (K x 2)
        z: true outputs (samples x K)
        step: sample time [s] (K)
        correlation: that of the disturbance [s] (K)
        ranges: declared ranges of d_r and d_l, from which they are drawn evenly (K x 2 x 2)
    """

    models: list[Matrices]
    noise: Floats
    disturbance: Floats
    bias: Floats
    world: World
    x_std: Floats
    u: Floats
    y: Floats
    x: Floats
    d: Floats
    z: Floats
    step: Floats
    correlation: Floats
    ranges: Floats


def problems(reach: str, world: World, order: int, count: int, seed: int) -> Problems:
    """Random stable plants with noise of 0.003 to 0.1, driven by two tones and an offset.

    Args:
        reach: where z comes: one of `REACHES`
        world: what they have besides noise
        order: of the plants
        count: how many
        seed: of everything random
    """
    rng = np.random.default_rng([seed, order, REACHES.index(reach)])
    t = np.arange(0.0, DURATION, STEP)
    models = [_plant(rng, order) for _ in range(count)]
    d = rng.uniform(*RANGE, (count, 2))
    noise = np.exp(rng.uniform(np.log(0.003), np.log(0.1), count))
    offset, amplitude = _excursion(rng, reach, d)
    drives = []
    for model, a, c in zip(models, amplitude, offset, strict=True):
        drives.append(drive(rng, model, t, a, c))
    u = np.stack(drives, axis=1)
    static = np.array([response(model, 0.0).real for model in models])
    w_rms, bias_rms = world.disturbance * np.abs(u).max(axis=0), np.abs(world.bias / static)
    w = noises.stationary_first_order_noise(seed, t.size, w_rms, CORRELATION, STEP)
    x_std = 1.0 if reach in ("both edges", "grazing") else 0.1
    x = rng.normal(size=(count, order)) * x_std
    bias = rng.normal(size=count) * bias_rms
    plants = [zoh(wrong_model(rng, model, world.tolerance), STEP) for model in models]
    A, B, C = (np.stack(part) for part in zip(*plants, strict=True))
    y, z = np.empty_like(u), np.empty_like(u)
    late = np.where(t > DURATION / 2, world.late, 0.0)[:, None] / static
    for k in range(t.size):
        last, z[k] = x, np.einsum("kij,kj->ki", C, x)[:, 0]
        y[k] = deadzone(z[k], d[:, 0], d[:, 1]) + noise * rng.normal(size=count)
        x = np.einsum("kij,kj->ki", A, x) + B[:, :, 0] * (u[k] + w[k] + bias + late[k])[:, None]
    return Problems(
        models,
        noise,
        w_rms,
        bias_rms,
        world,
        np.full((count, order), x_std),
        u,
        y,
        last,
        d,
        z,
        np.full(count, STEP),
        np.full(count, CORRELATION),
        np.broadcast_to(RANGE, (count, 2, 2)),
    )


def _excursion(rng: np.random.Generator, reach: str, d: Floats) -> tuple[Floats, Floats]:
    """Offset and amplitude of each z, such that it comes where `reach` says."""
    count = len(d)
    offset = rng.uniform(0.5, 3.0, count) if reach == "right edge only" else np.zeros(count)
    amplitudes = {
        "both edges": rng.uniform(3.0, 6.0, count),
        "grazing": d.max(axis=1) * rng.uniform(0.9, 1.2, count),
        "right edge only": offset + d[:, 1] * rng.uniform(0.0, 0.8, count),
        "no edge": d.min(axis=1) * rng.uniform(0.2, 0.8, count),
    }
    return offset, amplitudes[reach]


def _plant(rng: np.random.Generator, order: int) -> Matrices:
    """A stable plant in companion form, C = [1 0 ...]."""
    a = polynomial(stable_poles(rng, order))
    return companion(a, a[0] * rng.uniform(0.5, 2.0))


def stable_poles(rng: np.random.Generator, order: int) -> list[Any]:
    """One to three random poles."""
    frequency, damping = rng.uniform(1.0, 6.0), rng.uniform(0.2, 1.5)
    pair = np.roots([1.0, 2 * damping * frequency, frequency**2])
    return {1: [-frequency], 2: [*pair], 3: [*pair, -rng.uniform(0.5, 5.0)]}[order]


def polynomial(poles: list[Any]) -> Floats:
    """The coefficients of the polynomial with these roots, from s^0 up."""
    return np.asarray(np.poly(poles)[:0:-1].real)


def companion(a: Floats, size: float) -> Matrices:
    """The plant z^(n) + ... + a_0 z = size u."""
    A = np.eye(a.size, k=1)
    A[-1] = -a
    return Matrices(A, size * np.eye(a.size)[:, -1:], np.eye(a.size)[:1])


def wrong_model(rng: np.random.Generator, model: Matrices, tolerance: float) -> Matrices:
    """The plant behind a model whose last equation has relative errors."""
    last = np.arange(model.A.shape[0]) == model.A.shape[0] - 1
    factors = 1 + tolerance * rng.normal(size=(last.size, last.size + 1)) * last[:, None]
    return Matrices(model.A * factors[:, :-1], model.B * factors[:, -1:], model.C)


def response(model: Matrices, s: complex) -> Any:
    """The transfer function at s."""
    return (model.C @ np.linalg.solve(s * np.eye(model.A.shape[0]) - model.A, model.B))[0, 0] + 0j


def drive(
    rng: np.random.Generator, model: Matrices, t: Floats, amplitude: float, offset: float
) -> Floats:
    """u that leads z to offset + amplitude (0.8, 0.2) . two tones, risen to smoothly."""
    slow, phase = rng.uniform(0.2, 1.0), rng.uniform(0.0, 2 * np.pi, 2)
    u = np.full(t.size, offset / response(model, 0.0).real)
    for frequency, share, start in ((slow, 0.8, phase[0]), (2.3 * slow, 0.2, phase[1])):
        size = share * amplitude / response(model, 2j * np.pi * frequency)
        u += np.imag(size * np.exp(1j * (2 * np.pi * frequency * t + start)))
    rise = np.clip(t / RAMP, 0.0, 1.0)
    return u * rise**2 * (3 - 2 * rise)
