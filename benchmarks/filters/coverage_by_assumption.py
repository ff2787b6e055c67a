"""Whether shown intervals hold the truth where the world is as declared, and where it is not.

`python -m benchmarks coverage_by_assumption --folder FOLDER` keeps every part in the folder and
goes on where it stopped. With `--orders 3` that order alone is done; parts of all orders in one
folder join when all are asked for. `extended` is told the ranges alone, as `censored` is in its
second row.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.filters.coverage import ROUNDING
from benchmarks.filters.glitches import doubting, from_ranges, observe
from benchmarks.filters.problems.assumed_worlds import KINDS, ORDERS, RATES, SAMPLES, problems
from benchmarks.markdown import head, row
from benchmarks.results import load_or_compute
from undeadzone.observers import Extended
from undeadzone.util.arrays import Floats
from undeadzone_studies.statistics.intervals import proportion

ASSUMPTIONS = {"told": doubting, "ranges alone": from_ranges}
FILTERS = ASSUMPTIONS | {
    "`extended`": lambda known, k: Extended(right=known.ranges[k, 0], left=known.ranges[k, 1])
}
COLUMNS = (
    "world",
    "claims",
    "d_r",
    "d_l",
    "width",
    "centre",
    "z",
    "lowest, 95 % interval",
    "not consistent",
    "of runs that miss",
    "rms of z - z^ [widths]",
)


class Part(NamedTuple):
    """What a filter makes of the problems of one kind and order.

    Attributes:
        misses: errors beyond 1.96 standard deviations, of d_r, d_l, width, centre, z (K x 5)
        consistent: what it says in the end (K)
        rms: of z - z^ late in the run, over the mean of d_r and d_l (K)
    """

    misses: Floats
    consistent: Floats
    rms: Floats


def part(assumptions: str, kind: str, order: int, count: int, seed: int) -> Part:
    """Solve the problems of one kind and order."""
    posed = problems(KINDS[kind], order, count, seed)
    outcome = observe(FILTERS[assumptions], posed)
    errors, stds = outcome.verdict.errors, outcome.verdict.stds
    covered = np.abs(errors) <= 1.96 * stds + ROUNDING  # a number that is none holds nothing
    return Part(1.0 * ~covered, outcome.consistent, outcome.rms / posed.d.mean(axis=1))


def stored_part(
    folder: Path | None, assumptions: str, kind: str, order: int, count: int, seed: int
) -> Part:
    """`part`, from the folder if it is there already."""
    name = f"{assumptions}, {kind}, order {order}, {count} of seed {seed}"
    ask = functools.partial(part, assumptions, kind, order, count, seed)
    return Part(*load_or_compute(folder, name, ask))


def table(
    count: int = 100,
    seed: int = 0,
    folder: Path | None = None,
    orders: Sequence[int] = ORDERS,
    filters: Sequence[str] = tuple(FILTERS),
) -> str:
    """The table, from `count` problems of each order a row."""
    parts = {}
    for assumptions in filters:
        for order in orders:
            for kind in KINDS:
                parts[assumptions, kind, order] = stored_part(
                    folder, assumptions, kind, order, count, seed
                )
    lines = ["## Honesty: intervals where the world is as declared, and where it is not\n"]
    lines += head(*COLUMNS)
    for kind in KINDS:
        for assumptions in filters:
            each = [parts[assumptions, kind, order] for order in orders]
            pooled = Part(*(np.concatenate(values) for values in zip(*each, strict=True)))
            lines.append(row(kind, assumptions, *_cells(pooled)))
    rates = f"{RATES[0]:g} Hz to {RATES[1] / 1000:g} kHz"
    note = (
        f"{count * len(orders)} problems of orders {tuple(orders)} a row, "
        f"{SAMPLES} readings at {rates}. "
        "Told: true rms, and times, before what is wrong. Of runs that miss: the share of those "
        "with a miss among the five that then call themselves not consistent. `extended` knows the "
        "ranges alone: three levels and a bias, as where no disturbance is claimed."
    )
    return "\n".join([*lines, "", note, ""])


def _cells(pooled: Part) -> list[str]:
    """The outcome of a row in its cells."""
    runs = len(pooled.misses)
    shares = 1 - pooled.misses.mean(axis=0)
    lowest = proportion(runs - int(pooled.misses.sum(axis=0).max()), runs)
    flagged = pooled.consistent == 0
    missing = pooled.misses.any(axis=1)
    noticed = "-"
    if missing.any():
        noticed = f"{flagged[missing].mean():.2f} of {int(missing.sum())}"
    return [
        *(f"{share:.2f}" for share in shares),
        f"{lowest.low:.2f} to {lowest.high:.2f}",
        f"{flagged.mean():.2f}",
        noticed,
        f"{np.median(pooled.rms):.3g}",
    ]
