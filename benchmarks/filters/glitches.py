"""What wrong readings, and steps that no claim allows for, do to the filters.

Every problem is solved three times: by today's filter on wrong readings, and without them by that
filter and by the one that takes all readings for right.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
import numpy as np

from benchmarks.filters import coverage
from benchmarks.filters.problems.random_plants import DURATION, STEP, Problems, World, problems
from benchmarks.markdown import head, row
from undeadzone.observers import Auto
from undeadzone.util.arrays import Floats

ORDER = 2
QUIET, SHAKEN = World(), World(0.05, 0.2, 0.05)
HALF = int(DURATION / STEP / 2)  # samples
COLUMNS = (
    "readings",
    "filter",
    "d_r",
    "d_l",
    "width",
    "centre",
    "z",
    "flagged",
    "x median",
    "90 %",
)

Spoil = Callable[[np.random.Generator, Floats], Floats]
"""(generator, readings (samples x K)) -> readings of which some are wrong."""


class Outcome(NamedTuple):
    """What a filter makes of K problems.

    Attributes:
        verdict: on its estimates in the end.
        rms: rms of z - z^ from 2 s after the middle on (K).
        consistent: whether it says so in the end (K).
    """

    verdict: coverage.Verdict
    rms: Floats
    consistent: Floats


def doubting(known: Problems, k: int) -> Any:
    """`Censored` told the truth about problem k, but not of wrong readings."""
    return coverage.censored(known, k)


def from_ranges(known: Problems, k: int, options: Any = Auto) -> Any:
    """A filter told the ranges of the widths alone."""
    return options(right=known.ranges[k, 0], left=known.ranges[k, 1])


FILTERS = {
    "kalman": (coverage.kalman, QUIET),
    "censored": (doubting, SHAKEN),
    "auto, ranges alone": (from_ranges, SHAKEN),
}


def one_of(size: float, count: int = 1) -> Spoil:
    """Readings of that size in the middle, one after the other."""

    def spoil(rng: np.random.Generator, y: Floats) -> Floats:
        wrong = y.copy()
        wrong[HALF : HALF + count] = size
        return wrong

    return spoil


def tenth_of(wrong: Spoil) -> Spoil:
    """A tenth of the readings is wrong."""

    def spoil(rng: np.random.Generator, y: Floats) -> Floats:
        return np.where(rng.uniform(size=y.shape) < 0.1, wrong(rng, y), y)

    return spoil


def anywhere(rng: np.random.Generator, y: Floats) -> Floats:
    """Readings evenly spread over twice the range of the true ones."""
    return rng.uniform(-2, 2, y.shape) * np.abs(y).max(axis=0)


def zeros(rng: np.random.Generator, y: Floats) -> Floats:
    """No reading but 0."""
    return np.zeros_like(y)


def frozen(rng: np.random.Generator, y: Floats) -> Floats:
    """A sensor that is stuck for 1 s from the middle on."""
    wrong = y.copy()
    wrong[HALF : HALF + 100] = y[HALF]
    return wrong


def burst(rng: np.random.Generator, y: Floats) -> Floats:
    """Nothing but random readings for 0.3 s."""
    wrong = y.copy()
    wrong[HALF : HALF + 30] = anywhere(rng, y)[:30]
    return wrong


def clean(rng: np.random.Generator, y: Floats) -> Floats:
    """The readings as they are."""
    return y


def restless(rng: np.random.Generator, y: Floats) -> Floats:
    """A sensor that is stuck for 1 s from the middle on, but for noise."""
    wrong = frozen(rng, y)
    wrong[HALF : HALF + 100] += 0.03 * rng.normal(size=(100, y.shape[1]))
    return wrong


def at_first(rng: np.random.Generator, y: Floats) -> Floats:
    """Three wrong readings before any right one."""
    wrong = y.copy()
    wrong[:3] = 50.0
    return wrong


KINDS: dict[str, tuple[Spoil, float]] = {
    "right": (clean, 0.0),
    "one of 20": (one_of(20.0), 0.0),
    "one of 1e299": (one_of(1e299), 0.0),
    "five alike": (one_of(20.0, 5), 0.0),
    "0.3 s of random ones": (burst, 0.0),
    "stuck for 1 s": (frozen, 0.0),
    "10 % are 0": (tenth_of(zeros), 0.0),
    "10 % random": (tenth_of(anywhere), 0.0),
    "stuck and noisy for 1 s": (restless, 0.0),
    "the first three": (at_first, 0.0),
    "bias steps by 1": (clean, 1.0),
}


def observe(options: Callable[[Problems, int], Any], posed: Problems) -> Outcome:
    """Run an observer on every problem, one lane each.

    Args:
        options: of the observer for a problem.
        posed: the problems.
    """
    out = coverage.along(options, posed, ESTIMATES)
    late = HALF + int(2 / STEP)
    error = out[:, late:, 2] - posed.z[late:].T
    rms = np.sqrt(np.mean(error**2, axis=1))
    return Outcome(coverage.final_verdict(posed, out), rms, out[:, -1, 7])


ESTIMATES = coverage.selected(coverage.FINAL + "consistent")


def trusting(options: Callable[[Problems, int], Any]) -> Callable[[Problems, int], Any]:
    """The same observer that takes all readings for right."""

    def plain(known: Problems, k: int) -> Any:
        return msgspec.structs.replace(options(known, k), glitches=0.0)

    return plain


def table(count: int = 200, seed: int = 0) -> str:
    """The table, from `count` problems a row whose z reaches both edges."""
    lines = ["## Wrong readings, and steps\n", *head(*COLUMNS)]
    for name, (options, world) in FILTERS.items():
        for kind, (spoil, late) in KINDS.items():
            posed = problems("both edges", world._replace(late=late), ORDER, count, seed)
            usual = observe(trusting(options), posed)
            wrong = spoil(np.random.default_rng(seed + 1), posed.y)
            outcome = observe(options, posed._replace(y=wrong))
            lines.append(row(kind, name, *_cells(outcome, usual)))
    note = (
        f"{count} problems of order {ORDER} a row, {DURATION:g} s at {1 / STEP:g} Hz. x: rms of "
        "z - z^ from 2 s after the middle on, over that of the same filter that takes all readings "
        "for right, on readings that are right."
    )
    return "\n".join([*lines, "", note, ""])


def _cells(outcome: Outcome, usual: Outcome) -> list[str]:
    """An outcome in the cells of a row."""
    shares = [f"{share:.2f}" for share in outcome.verdict.covered()]
    ratio = outcome.rms / np.fmax(usual.rms, 1e-12)
    median, most = np.quantile(ratio, [0.5, 0.9])
    return [*shares, f"{1 - outcome.consistent.mean():.2f}", f"{median:.3g}", f"{most:.3g}"]
