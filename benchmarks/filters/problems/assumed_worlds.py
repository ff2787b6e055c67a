"""Problems in which the world is as declared, or is not: orders 1 to 4, 50 Hz to 50 kHz.

Stable, unstable and integrating plants, zones of very unequal edges, wrong and missing readings,
late steps. Each is posed in seconds of its own plant, and then stated in another unit of time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.filters.glitches import (
    HALF,
    Spoil,
    anywhere,
    clean,
    frozen,
    one_of,
    tenth_of,
    zeros,
)
from benchmarks.filters.problems.random_plants import (
    CORRELATION,
    Problems,
    World,
    companion,
    drive,
    polynomial,
    response,
    wrong_model,
)
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.util.arrays import Floats

ORDERS = (1, 2, 3, 4)
SAMPLES = 2 * HALF
RATES = (50.0, 50e3)  # readings in 1 s
STEPS = (0.005, 0.02)  # between readings, in seconds of the plant's own
RATIOS = (0.05, 20.0)  # of the declared range of d_r over that of d_l
SPAN = (0.3, 2.0)  # declared range over its scale
ASSUMED = World(disturbance=0.2, bias=0.2, tolerance=0.05)  # what constants move z, in mean widths


class Kind(NamedTuple):
    """What is special about a kind of problem.

    Attributes:
        declared: whether the world is as the claims say
        reach: where z comes: "both edges", "grazing", "right edge only" or "no edge"
        poles: "stable", "unstable" (one of them) or "marginal" (one integrates)
        missing: share of the readings
        spoil: what happens to readings
        gust, error: rms of the disturbance, and of the model's error, over those that are claimed
        bias_step, gust_step: constant from the middle on, in rms that are claimed
    """

    declared: bool = False
    reach: str = "both edges"
    poles: str = "stable"
    missing: float = 0.0
    spoil: Spoil = clean
    gust: float = 1.0
    error: float = 1.0
    bias_step: float = 0.0
    gust_step: float = 0.0


KINDS = {
    "both edges": Kind(True),
    "grazing": Kind(True, reach="grazing"),
    "right edge only": Kind(True, reach="right edge only"),
    "no edge": Kind(True, reach="no edge"),
    "30 % missing": Kind(True, missing=0.3),
    "unstable": Kind(True, poles="unstable"),
    "integrator": Kind(True, poles="marginal"),
    "five wrong ones": Kind(spoil=one_of(20.0, 5)),
    "stuck for 1 s": Kind(spoil=frozen),
    "10 % are 0": Kind(spoil=tenth_of(zeros)),
    "10 % random": Kind(spoil=tenth_of(anywhere)),
    "model error doubled": Kind(error=2.0),
    "gust a sixteenth": Kind(gust=1 / 16),
    "gust doubled": Kind(gust=2.0),
    "gust fourfold": Kind(gust=4.0),
    "gust steps by 2 rms": Kind(gust_step=2.0),
    "bias steps by 5 rms": Kind(bias_step=5.0),
}


class Plants(NamedTuple):
    """K plants under the state feedback that leads z, all in seconds of their own.

    Attributes:
        models, led: as a filter knows them, and with the feedback
        feedback: of the state into the input (K x n)
    """

    models: list[Matrices]
    led: list[Matrices]
    feedback: Floats


def problems(
    kind: Kind,
    order: int,
    count: int,
    seed: int,
    assumed: World = ASSUMED,
    ratios: tuple[float, float] = RATIOS,
) -> Problems:
    """Problems of a kind.

    Args:
        kind: what is special about them
        order: of the plants
        count: how many
        seed: of everything random
        assumed: what constants move z, in mean widths, and the model's error
        ratios: of the declared range of d_r over that of d_l
    """
    rng = np.random.default_rng([seed, order])
    plants = _plants(rng, kind.poles, order, count)
    scale = np.sqrt(_log_uniform(rng, ratios, count))
    ranges = np.stack([scale, 1 / scale], axis=1)[:, :, None] * np.array(SPAN)
    d = rng.uniform(ranges[:, :, 0], ranges[:, :, 1])
    noise = _log_uniform(rng, (0.003, 0.1), count) * np.sqrt(d.min(axis=1) * d.max(axis=1))
    step = _log_uniform(rng, STEPS, count)
    lead = _drives(rng, kind.reach, plants.led, d, step)
    static = np.array([response(led, 0.0).real for led in plants.led])
    width = d.mean(axis=1)
    w_rms = assumed.disturbance * width / np.abs(static)
    bias_rms = assumed.bias * width / np.abs(static)
    x_std = width * (1.0 if kind.reach in ("both edges", "grazing") else 0.1)
    posed = Problems(
        models=plants.models,
        noise=noise,
        disturbance=w_rms,
        bias=bias_rms,
        world=assumed,
        x_std=np.repeat(x_std[:, None], order, axis=1),
        u=lead,
        y=np.empty_like(lead),
        x=np.empty((count, order)),
        d=d,
        z=np.empty_like(lead),
        step=step,
        correlation=np.full(count, CORRELATION),
        ranges=ranges,
    )
    posed = _run(rng, kind, posed, plants)
    return in_unit(posed, 1 / (_log_uniform(rng, RATES, count) * step))


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float], count: int) -> Floats:
    """Numbers whose logarithms are evenly spread."""
    return np.exp(rng.uniform(np.log(ends[0]), np.log(ends[1]), count))


def _plants(rng: np.random.Generator, poles: str, order: int, count: int) -> Plants:
    """Random plants in companion form, and feedback that makes them stable."""
    models, led, feedback = [], [], []
    for _ in range(count):
        frequency, damping = rng.uniform(1.0, 6.0), rng.uniform(0.2, 1.5)
        pair = list(np.roots([1.0, 2 * damping * frequency, frequency**2]))
        others = list(-rng.uniform(0.5, 5.0, 2))
        chosen_poles = {1: [-frequency], 2: pair, 3: [*pair, others[0]], 4: [*pair, *others]}[order]
        own = list(chosen_poles)
        if poles != "stable":
            own = [-frequency, *others, -1.0][: order - 1]
            own.append(rng.uniform(0.2, 1.0) if poles == "unstable" else 0.0)
        size = abs(np.prod(chosen_poles)) * rng.uniform(0.5, 2.0)
        a, a_led = polynomial(own), polynomial(chosen_poles)
        models.append(companion(a, size))
        led.append(companion(a_led, size))
        feedback.append((a_led - a) / size)
    return Plants(models, led, np.array(feedback))


def _drives(
    rng: np.random.Generator, reach: str, led: list[Matrices], d: Floats, step: Floats
) -> Floats:
    """Inputs beside the feedback, that lead z where `reach` says (samples x K)."""
    count = len(led)
    offset = d[:, 0] * rng.uniform(0.3, 1.5, count) * (reach == "right edge only")
    amplitudes = {
        "both edges": d.max(axis=1) * rng.uniform(1.5, 3.0, count),
        "grazing": d.max(axis=1) * rng.uniform(0.9, 1.2, count),
        "right edge only": offset + d[:, 1] * rng.uniform(0.0, 0.8, count),
        "no edge": d.min(axis=1) * rng.uniform(0.2, 0.8, count),
    }
    inputs = []
    for model, a, c, Ts in zip(led, amplitudes[reach], offset, step, strict=True):
        inputs.append(drive(rng, model, Ts * np.arange(SAMPLES), a, c))
    return np.stack(inputs, axis=1)


def _run(rng: np.random.Generator, kind: Kind, posed: Problems, plants: Plants) -> Problems:
    """The problems with inputs, readings and truth."""
    count, order = posed.x.shape
    real = []
    for model, Ts in zip(plants.models, posed.step, strict=True):
        real.append(zoh(wrong_model(rng, model, kind.error * posed.world.tolerance), Ts))
    A, B, C = (np.stack(part) for part in zip(*real, strict=True))
    x = rng.normal(size=(count, order)) * posed.x_std
    bias = rng.normal(size=count) * posed.bias
    late = kind.bias_step * posed.bias + kind.gust_step * posed.disturbance
    fade = np.exp(-posed.step / posed.correlation)
    w = rng.normal(size=count)
    u, y, z = posed.u.copy(), np.empty_like(posed.y), np.empty_like(posed.z)
    for k in range(SAMPLES):
        last, z[k] = x, np.einsum("kij,kj->ki", C, x)[:, 0]
        y[k] = deadzone(z[k], *posed.d.T) + posed.noise * rng.normal(size=count)
        u[k] -= np.einsum("ki,ki->k", plants.feedback, x)
        unknown = bias + late * (k >= HALF) + kind.gust * posed.disturbance * w
        x = np.einsum("kij,kj->ki", A, x) + B[:, :, 0] * (u[k] + unknown)[:, None]
        w = fade * w + np.sqrt(1 - fade**2) * rng.normal(size=count)
    y = np.where(rng.uniform(size=y.shape) < kind.missing, np.nan, kind.spoil(rng, y))
    return posed._replace(u=u, y=y, z=z, x=last)


def in_unit(posed: Problems, unit: Floats) -> Problems:
    """The same problems with so many seconds for one of their own (K).

    The rows that only name a derivative stay as they are, to the last bit: they are exact.
    """
    order = posed.x.shape[1]
    powers = unit[:, None] ** -np.arange(order)
    models = []
    for model, one, T in zip(posed.models, unit, powers, strict=True):
        A = model.A.copy()
        A[-1] = T[-1] * A[-1] / T / one
        models.append(Matrices(A, T[:, None] * model.B / one, model.C / T))
    return posed._replace(
        models=models,
        x_std=posed.x_std * powers,
        x=posed.x * powers,
        step=posed.step * unit,
        correlation=posed.correlation * unit,
    )
