"""Whether a filter names the claim that is false, and is silent where all of them are true.

Each row takes honest problems and makes one claim about sensor, noise or plant a little false.
`python -m benchmarks.claims --count 60` poses so many problems a row, drawn evenly from the orders.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from benchmarks.honest_problems import KINDS, ORDERS, SAMPLES, Kind, problems
from benchmarks.random_problems import Problems
from undeadzone.ends.sensor import deadzone
from undeadzone.support.arrays import Floats

SEED = 70_000  # of which no other benchmark draws
TOP = 1.3  # true width over the top of its claimed range
STEEP = 1.1  # true slope of a sensor whose claimed slope is 1
LOUD, LOUD_SHARE, BLOCK = 4.0, 0.4, 50  # noise over what is claimed, how often, samples at a time
OFFSET, OFF = 0.3, 0.25  # of all readings, and of a tenth of them, in mean widths
STEPS = (0.2, 0.6)  # of a width, in widths
GROWTH = 0.3  # of a width over the run
LAGS = (1 / 8, 1 / 3)  # time constant over that of the plant's slowest pole
STUCK = slice(SAMPLES // 2, SAMPLES // 2 + SAMPLES // 10)
NOISY = slice(SAMPLES // 2, SAMPLES // 2 + 2 * SAMPLES // 5)

World = Callable[[np.random.Generator, Problems], Problems]
"""(generator, honest problems) -> the same with a claim that is false."""


def reread(
    rng: np.random.Generator,
    posed: Problems,
    right: Floats | None = None,
    left: Floats | None = None,
    slope: float = 1.0,
    offset: Floats | float = 0.0,
    noise: Floats | float = 1.0,
) -> Problems:
    """The problems with other readings of the same motion.

    Args:
        rng: of the noise.
        posed: the problems.
        right, left: widths along the samples (samples x K) [z]; None: they stay.
        slope: of the sensor.
        offset: of the readings.
        noise: over what is claimed.
    """
    d_r = np.broadcast_to(posed.d[:, 0], posed.z.shape) if right is None else right
    d_l = np.broadcast_to(posed.d[:, 1], posed.z.shape) if left is None else left
    y = slope * deadzone(posed.z, d_r, d_l) + offset
    y = y + noise * posed.noise * rng.normal(size=y.shape)
    return posed._replace(y=y, d=np.column_stack([d_r[-1], d_l[-1]]))


def honest(rng: np.random.Generator, posed: Problems) -> Problems:
    """All claims are true."""
    return posed


def beyond_range(rng: np.random.Generator, posed: Problems) -> Problems:
    """One width of each problem is wider than its range."""
    ranges, which = posed.ranges.copy(), rng.integers(2, size=len(posed.d))
    each = np.arange(which.size)
    tops = ranges[each, which, 1]
    ranges[each, which] *= (posed.d[each, which] / TOP / tops)[:, None]
    return posed._replace(ranges=ranges)


def steep(rng: np.random.Generator, posed: Problems) -> Problems:
    """The sensor is steeper."""
    return reread(rng, posed, slope=STEEP)


def loud(rng: np.random.Generator, posed: Problems) -> Problems:
    """The noise is larger for a while, again and again."""
    louder = rng.uniform(size=(SAMPLES // BLOCK, len(posed.d))) < LOUD_SHARE
    return reread(rng, posed, noise=np.where(np.repeat(louder, BLOCK, axis=0), LOUD, 1.0))


def shifted(rng: np.random.Generator, posed: Problems) -> Problems:
    """All readings have an offset of either sign."""
    sign = rng.choice([-1.0, 1.0], len(posed.d))
    return reread(rng, posed, offset=sign * OFFSET * posed.d.mean(axis=1))


def stepping(rng: np.random.Generator, posed: Problems) -> Problems:
    """A width steps in the middle, up or down."""
    size = rng.uniform(*STEPS, len(posed.d)) * rng.choice([-1.0, 1.0], len(posed.d))
    return _moving_width(rng, posed, size * (np.arange(SAMPLES) >= SAMPLES // 2)[:, None])


def growing(rng: np.random.Generator, posed: Problems) -> Problems:
    """A width grows from the first sample on."""
    return _moving_width(rng, posed, GROWTH * np.linspace(0, 1, SAMPLES)[:, None])


def _moving_width(rng: np.random.Generator, posed: Problems, change: Floats) -> Problems:
    """One width of each problem changes, by so much of itself."""
    first = rng.integers(2, size=len(posed.d)) == 0
    right = posed.d[:, 0] * (1 + change * first)
    left = posed.d[:, 1] * (1 + change * ~first)
    return reread(rng, posed, right, left)


def off(rng: np.random.Generator, posed: Problems) -> Problems:
    """A tenth of the readings is off by a part of a width."""
    sign = rng.choice([-1.0, 1.0], posed.y.shape)
    wrong = sign * OFF * posed.d.mean(axis=1)
    return posed._replace(
        y=np.where(rng.uniform(size=posed.y.shape) < 0.1, posed.y + wrong, posed.y)
    )


def lagging(rng: np.random.Generator, posed: Problems) -> Problems:
    """The input reaches the plant through a lag that no model has: u is what enters the lag."""
    slowest = []
    for model in posed.models:
        slowest.append(1 / np.abs(np.linalg.eigvals(model.A)).min())
    lag = rng.uniform(*LAGS, len(slowest)) * np.array(slowest)
    kept = np.exp(-posed.step / lag)
    after = np.concatenate([posed.u[1:], posed.u[-1:]])
    return posed._replace(u=(after - kept * posed.u) / (1 - kept))


def stuck(rng: np.random.Generator, posed: Problems) -> Problems:
    """The sensor repeats a reading for a tenth of the run."""
    y = posed.y.copy()
    y[STUCK] = y[STUCK.start]
    return posed._replace(y=y)


def stuck_and_noisy(rng: np.random.Generator, posed: Problems) -> Problems:
    """The sensor repeats a reading, with fresh noise, for two fifths of the run."""
    y = posed.y.copy()
    y[NOISY] = y[NOISY.start] + posed.noise * rng.normal(size=y[NOISY].shape)
    return posed._replace(y=y)


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        world: what is false.
        names: of claims, any of which is right as the first one.
        kind: of the honest problems.
        orders: of the plants.
    """

    world: World
    names: tuple[str, ...] = ()
    kind: Kind = KINDS["both edges"]
    orders: tuple[int, ...] = ORDERS


ROWS = {
    "width 1.3 x top of range": Row(beyond_range, ("range",)),
    "slope 1.1": Row(steep, ("slope",)),
    "noise x 4 in 40 % of the time": Row(loud, ("noise",)),
    "offset of .3 widths": Row(shifted, ("offset",)),
    "a width steps by .2 to .6": Row(stepping, ("width", "offset")),
    "a width grows by 30 %": Row(growing, ("width", "offset")),
    "10 % off by .25 widths": Row(off, ("noise", "glitches")),
    "lag of 1/8 to 1/3": Row(lagging, ("dynamics",)),
    "constant of 5 rms from the middle on": Row(
        honest, ("gust", "bias"), KINDS["bias steps by 5 rms"]
    ),
    "stuck for a tenth": Row(stuck, ("stuck",)),
    "stuck and noisy for .4": Row(stuck_and_noisy, ("stuck",)),
}
CLASSES = {"stable": "both edges", "integrating": "integrator", "unstable": "unstable"}
for poles, kind in CLASSES.items():
    for order in ORDERS:
        ROWS[f"honest, {poles}, order {order}"] = Row(honest, (), KINDS[kind], (order,))


def posed_of(row: Row, order: int, count: int, seed: int) -> Problems:
    """The problems of a row and an order."""
    posed = problems(row.kind, order, count, seed)
    return row.world(np.random.default_rng([seed, order, 1]), posed)
