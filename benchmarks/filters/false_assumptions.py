"""Whether a filter names the claim that is false, and is silent where all of them are true.

Each row takes honest problems and makes one claim about sensor, noise or plant a little false.
`python -m benchmarks false_assumptions --count 60` poses so many problems a row,
drawn evenly from the orders.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from benchmarks.filters import coverage
from benchmarks.filters.coverage_by_assumption import ASSUMPTIONS
from benchmarks.filters.problems.assumed_worlds import (
    ASSUMED,
    KINDS,
    ORDERS,
    SAMPLES,
    Kind,
    problems,
)
from benchmarks.filters.problems.random_plants import Problems, World
from benchmarks.markdown import head, row
from undeadzone.interfaces import ASSUMPTION_CHECKS as TABLE
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.util.arrays import Floats

SEED = 310_000  # of which nothing else draws: thresholds stood before
TOP = 1.3  # true width over the top of its claimed range
STEEP = 1.1  # true slope of a sensor whose claimed slope is 1
LOUD, LOUD_SHARE, BLOCK = 4.0, 0.4, 50  # noise over what is claimed, how often, samples at a time
OFFSET, OFF = 0.3, 0.25  # of all readings, and of a tenth of them, in mean widths
STEPS = (0.2, 0.6)  # of a width, in widths
GROWTH = 0.3  # of a width over the run
LAGS = (1 / 8, 1 / 3)  # time constant over that of the plant's slowest pole
STUCK = slice(SAMPLES // 2, SAMPLES // 2 + SAMPLES // 10)
PIECES = 21  # of a log that is glued, in another order
NOISY = slice(SAMPLES // 2, SAMPLES // 2 + 2 * SAMPLES // 5)

ASSUMED_WORLDS = (World(disturbance=0.02, bias=0.02, tolerance=0.005), ASSUMED)

Change = Callable[[np.random.Generator, Problems], Problems]
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
    return reread(rng, posed, *stepped_widths(rng, posed))


def growing(rng: np.random.Generator, posed: Problems) -> Problems:
    """A width grows from the first sample on."""
    return reread(rng, posed, *grown_widths(rng, posed))


def stepped_widths(rng: np.random.Generator, posed: Problems) -> tuple[Floats, Floats]:
    """Right and left widths along the samples, one of which steps (samples x K) [z]."""
    size = rng.uniform(*STEPS, len(posed.d)) * rng.choice([-1.0, 1.0], len(posed.d))
    return _moving_width(rng, posed, size * (np.arange(SAMPLES) >= SAMPLES // 2)[:, None])


def grown_widths(rng: np.random.Generator, posed: Problems) -> tuple[Floats, Floats]:
    """Right and left widths along the samples, one of which grows (samples x K) [z]."""
    return _moving_width(rng, posed, GROWTH * np.linspace(0, 1, SAMPLES)[:, None])


def _moving_width(
    rng: np.random.Generator, posed: Problems, change: Floats
) -> tuple[Floats, Floats]:
    """Right and left widths, one of which changes by so much of itself (samples x K) [z]."""
    first = rng.integers(2, size=len(posed.d)) == 0
    return posed.d[:, 0] * (1 + change * first), posed.d[:, 1] * (1 + change * ~first)


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
    decay = np.exp(-posed.step / lag)
    after = np.concatenate([posed.u[1:], posed.u[-1:]])
    return posed._replace(u=(after - decay * posed.u) / (1 - decay))


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


def glued(rng: np.random.Generator, posed: Problems) -> Problems:
    """The log is glued from pieces in any order, so that the state jumps."""
    pieces = np.array_split(np.arange(SAMPLES), PIECES)
    rows = np.concatenate([pieces[k] for k in rng.permutation(PIECES)])
    return posed._replace(u=posed.u[rows], y=posed.y[rows], z=posed.z[rows])


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        change: what is false.
        names: of claims, any of which is right as the first one.
        kind: of the honest problems.
        orders: of the plants.
    """

    change: Change
    names: tuple[str, ...] = ()
    kind: Kind = KINDS["both edges"]
    orders: tuple[int, ...] = ORDERS


ROWS = {
    "width 1.3 x top of range": Row(beyond_range, ("range",)),
    "slope 1.1": Row(steep, ("slope",)),
    "noise x 4 in 40 % of the time": Row(loud, ("noise",)),
    "offset of .3 widths": Row(shifted, ("sensor",)),
    "a width steps by .2 to .6": Row(stepping, ("sensor",)),
    "a width grows by 30 %": Row(growing, ("range",)),
    "10 % off by .25 widths": Row(off, ("noise", "glitches")),
    "lag of 1/8 to 1/3": Row(lagging, ("dynamics",)),
    "late constant": Row(honest, ("gust",), KINDS["bias steps by 5 rms"]),
    "stuck for a tenth": Row(stuck, ("sensor",)),
    "stuck and noisy for .4": Row(stuck_and_noisy, ("sensor",)),
    "glued from 21 pieces": Row(glued, ("sensor",)),
}
CLASSES = {"stable": "both edges", "integrating": "integrator", "unstable": "unstable"}
POLES = tuple(KINDS[kind].poles for kind in CLASSES.values())
COLUMNS = (
    "world",
    "claims",
    "covered",
    "flagged",
    "of runs that miss",
    "right name first, of flagged",
    "named most",
)


class Part(NamedTuple):
    """What a filter makes of some problems of a row.

    Attributes:
        misses: errors of d_r, d_l, z beyond 1.96 standard deviations (K x 3)
        suspects: number of the claim that it takes for false in the end, 0: none (K)
    """

    misses: Floats
    suspects: Floats


def rows() -> dict[str, Row]:
    """All rows: claims that are false, and classes of plants of which all claims are true."""
    honest_ones = {}
    for poles, kind in CLASSES.items():
        for order in ORDERS:
            name = f"honest, {poles}, order {order}"
            honest_ones[name] = Row(honest, (), KINDS[kind], (order,))
    return ROWS | honest_ones


def posed_of(row: Row, order: int, count: int, seed: int, assumed: World) -> Problems:
    """The problems of a row, an order, and a world of honest claims."""
    posed = problems(row.kind, order, count, seed, assumed)
    return row.change(np.random.default_rng([seed, order, 1]), posed)


def part(options: Callable[[Problems, int], Any], posed: Problems) -> Part:
    """What a filter makes of problems."""
    out = coverage.along(options, posed, ESTIMATES)[:, -1]
    covered = np.abs(out[:, :3] - coverage.truth(posed)) <= 1.96 * out[:, 3:6] + coverage.ROUNDING
    return Part(1.0 * ~covered, out[:, 6])


ESTIMATES = coverage.selected("right left z right_std left_std x_std suspect")


def joined(each: Sequence[Problems]) -> Problems:
    """Problems of plants of one order and kind, in one world, as one lot."""
    found = {"world": each[0].world, "models": [model for one in each for model in one.models]}
    for name in set(Problems._fields) - set(found):
        arrays = [getattr(one, name) for one in each]
        found[name] = np.concatenate(arrays, axis=1 if name in ("u", "y", "z") else 0)
    return Problems(**found)


def parts_of(
    poses: dict[str, Row], assumptions: str, count: int, seed: int, orders: Sequence[int]
) -> dict[str, list[Part]]:
    """The parts of each row, whose problems are solved together where one graph serves them."""
    found: dict[str, list[Part]] = {name: [] for name in poses}
    for order, poles in product(orders, POLES):
        mine = {}
        for name, each in poses.items():
            if order in each.orders and each.kind.poles == poles:
                mine[name] = each
        for k, assumed in enumerate(ASSUMED_WORLDS):
            lots = []
            for each in mine.values():
                some = -(-count // (len(set(each.orders) & set(orders)) * len(ASSUMED_WORLDS)))
                lots.append(posed_of(each, order, some, seed + k, assumed))
            if not lots:
                continue
            whole = part(ASSUMPTIONS[assumptions], joined(lots))
            ends = np.cumsum([len(lot.d) for lot in lots])[:-1]
            for name, *one in zip(mine, *[np.split(array, ends) for array in whole], strict=True):
                found[name].append(Part(*one))
            print(assumptions, order, poles, k, file=sys.stderr, flush=True)
    return found


def table(
    count: int = 200, seed: int = SEED, orders: Sequence[int] = ORDERS, only: str = ""
) -> str:
    """The table, from `count` problems a row; `only` of rows whose name holds a word."""
    lines = ["## False claims, and true ones\n", *head(*COLUMNS)]
    poses = {name: each for name, each in rows().items() if set(each.orders) & set(orders)}
    poses = {name: poses[name] for name in poses if only in name}
    found = {
        assumptions: parts_of(poses, assumptions, count, seed, orders)
        for assumptions in ASSUMPTIONS
    }
    for name, each in poses.items():
        for assumptions, parts in found.items():
            misses = np.concatenate([one.misses for one in parts[name]])
            suspects = np.concatenate([one.suspects for one in parts[name]]).astype(int)
            lines.append(row(name, assumptions, *_cells(misses, suspects, each.names)))
    note = (
        f"{count} problems of orders {tuple(orders)} a row, half of them with a tenth of the "
        "disturbance, bias and error of the model; drawn as in `coverage_by_assumption`, from "
        "other seeds. Covered: lowest of d_r, d_l and z in the end. Intervals of flagged runs are "
        "wider."
    )
    return "\n".join([*lines, "", note, ""])


def _cells(misses: Floats, suspects: Floats, right: tuple[str, ...]) -> list[str]:
    """A row in its cells."""
    names = ["-", *TABLE]
    first = [names[k] for k in suspects[suspects > 0]]
    missed = misses.any(axis=1)
    noticed = f"{(suspects[missed] > 0).mean():.2f} of {missed.sum()}" if missed.any() else "-"
    known = f"{np.isin(first, right).mean():.2f}" if right and first else "-"
    most = ", ".join(f"{name} {count}" for name, count in Counter(first).most_common(3))
    covered = 1 - misses.mean(axis=0).max()
    return [f"{covered:.2f}", f"{(suspects > 0).mean():.2f}", noticed, known, most]
