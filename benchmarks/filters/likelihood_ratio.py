"""Whether readings can tell a false claim at all: the likelihood ratio against the very truth.

The same filter follows the same readings once with the claim and once with the truth in its place.
No test that is wrong on one honest problem in twenty tells more than the ratio of both likelihoods
(Neyman and Pearson), and no filter knows which other truth to compare with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.filters import coverage
from benchmarks.filters.coverage_by_assumption import ASSUMPTIONS
from benchmarks.filters.false_assumptions import (
    ASSUMED_WORLDS,
    OFFSET,
    ROWS,
    SEED,
    STEEP,
    TOP,
    Row,
    grown_widths,
    honest,
    posed_of,
    stepped_widths,
)
from benchmarks.filters.problems.assumed_worlds import ORDERS
from benchmarks.filters.problems.random_plants import Problems, World
from benchmarks.markdown import head, row
from undeadzone.util.arrays import Floats

GATE = 4.0  # rms of noise beyond which a reading is none of silence
FARTHEST = 6.0  # deviations of an innovation that count
ALARMS = 0.05  # share of honest problems on which the ratio may be wrong
NOTE = """{count} problems a row as in `false_assumptions`. Missed: an interval of d_r, d_l or z
that does not hold in the end. Told: by the ratio of the likelihoods, whose limit {alarms:.0%} of as
many honest problems pass. The ratio knows the truth that is to be told from the claim; `consistent`
does not.
"""

Truth = Callable[[np.random.Generator, Problems], Problems]
"""(generator as of the row's change, problems) -> the same as told to who knows what is false."""


def wider(rng: np.random.Generator, posed: Problems) -> Problems:
    """Ranges that hold the width."""
    top = posed.ranges[:, :, 1:] * (TOP + 0.15)
    return posed._replace(ranges=np.concatenate([posed.ranges[:, :, :1], top], axis=2))


def less_steep(rng: np.random.Generator, posed: Problems) -> Problems:
    """Readings and noise over the slope: what a sensor of slope 1 would give."""
    return posed._replace(y=posed.y / STEEP, noise=posed.noise / STEEP)


def centred(rng: np.random.Generator, posed: Problems) -> Problems:
    """Readings without the offset."""
    sign = rng.choice([-1.0, 1.0], len(posed.d))
    return posed._replace(y=posed.y - sign * OFFSET * posed.d.mean(axis=1))


def settled(
    widths: Callable[[np.random.Generator, Problems], tuple[Floats, Floats]],
) -> Truth:
    """Readings as widths that stand still at their last values would give them.

    What such a zone would not have read is missing.

    Args:
        widths: how they moved.
    """

    def truth(rng: np.random.Generator, posed: Problems) -> Problems:
        # the generator gives the factors by which the first widths moved, whatever these are
        right, left = widths(rng, posed._replace(d=np.ones_like(posed.d)))
        edge = GATE * posed.noise
        y = posed.y.copy()
        for sign, moved, last in ((1, right, posed.d[:, 0]), (-1, left, posed.d[:, 1])):
            further = last * (moved / moved[-1] - 1)  # than the last edge [z]
            read = sign * posed.y > edge
            shifted = posed.y + sign * further
            y[read] = np.where(sign * shifted > edge, shifted, np.nan)[read]
            y[(np.abs(posed.y) <= edge) & (further > 0)] = np.nan
        return posed._replace(y=y)

    return truth


TRUTHS: dict[str, tuple[Truth, float]] = {  # with the unit of its readings, over that of the claim
    "width 1.3 x top of range": (wider, 1.0),
    "slope 1.1": (less_steep, 1 / STEEP),
    "offset of .3 widths": (centred, 1.0),
    "a width steps by .2 to .6": (settled(stepped_widths), 1.0),
    "a width grows by 30 %": (settled(grown_widths), 1.0),
}


class Outcome(NamedTuple):
    """What a filter makes of some problems.

    Attributes:
        misses: whether an interval does not hold in the end (K).
        flagged: whether a claim is called false (K).
        log: log of the density with which it foretold each reading (K x samples).
        used: whether it used it (K x samples).
    """

    misses: Floats
    flagged: Floats
    log: Floats
    used: Floats


def observe_problems(assumptions: str, posed: Problems) -> Outcome:
    """A filter along problems."""
    out = coverage.along(ASSUMPTIONS[assumptions], posed, ESTIMATES)
    end, e, std = out[:, -1], out[:, :, 7], out[:, :, 8]
    covered = np.abs(end[:, :3] - coverage.truth(posed)) <= 1.96 * end[:, 3:6] + coverage.ROUNDING
    used, safe = e != 0, np.where(e != 0, std, 1.0)
    log = np.where(used, -(np.minimum(np.abs(e / safe), FARTHEST) ** 2) / 2 - np.log(safe), 0.0)
    return Outcome(~covered.all(axis=1), end[:, 6] > 0, log, used)


ESTIMATES = coverage.selected(
    "right left z right_std left_std x_std suspect innovation innovation_std"
)


def ratio(
    name: str, assumptions: str, each: Row, order: int, count: int, seed: int, world: World
) -> Any:
    """(what the filter with the claim makes of problems; log of the likelihood ratio)."""
    truth, unit = TRUTHS[name]
    posed = posed_of(each, order, count, seed, world)
    assumed = observe_problems(assumptions, posed)
    known = observe_problems(assumptions, truth(np.random.default_rng([seed, order, 1]), posed))
    both = assumed.used & known.used
    return assumed, np.where(both, known.log + np.log(unit) - assumed.log, 0.0).sum(axis=1)


def table(count: int = 200, seed: int = SEED, orders: Sequence[int] = ORDERS) -> str:
    """The table."""
    columns = ("world", "claims", "told, of all", "missed", "flagged of missed", "told of missed")
    note = NOTE.format(count=count, alarms=ALARMS)
    lines = ["## What readings can tell of a false claim\n", note, *head(*columns)]
    for name in TRUTHS:
        for assumptions in ASSUMPTIONS:
            lines.append(row(name, assumptions, *_cells(name, assumptions, count, seed, orders)))
    return "\n".join([*lines, ""])


def _cells(name: str, assumptions: str, count: int, seed: int, orders: Sequence[int]) -> list[str]:
    """A row in its cells."""
    each, ratios, plain = [], [], []
    some = -(-count // (len(orders) * len(ASSUMED_WORLDS)))
    for order in orders:
        for k, world in enumerate(ASSUMED_WORLDS):
            assumed, of_false = ratio(name, assumptions, ROWS[name], order, some, seed + k, world)
            fresh = seed + len(ASSUMED_WORLDS) + k
            _, of_true = ratio(name, assumptions, Row(honest), order, some, fresh, world)
            each.append(assumed)
            ratios.append(of_false)
            plain.append(of_true)
    missed = np.concatenate([assumed.misses for assumed in each])
    flagged = np.concatenate([assumed.flagged for assumed in each])[missed]
    detected = np.concatenate(ratios) > np.quantile(np.concatenate(plain), 1 - ALARMS)
    shares = [f"{part.mean():.2f}" if part.size else "-" for part in (flagged, detected[missed])]
    return [f"{detected.mean():.2f}", str(missed.sum()), *shares]
