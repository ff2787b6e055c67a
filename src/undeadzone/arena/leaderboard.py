"""From results to ranks: regret against two lines, median and worst over scenarios, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from typing import Any, Final

import msgspec
import numpy as np

from undeadzone.arena.metric import Result, Worth
from undeadzone.statistics.intervals import LEVEL, Interval
from undeadzone.support.arrays import Floats

FRAME: Final = ("full_state", "luenberger")  # regret 0 and 1
CAP: Final = 10.0  # regret of a run that diverged, and the largest of any
REFUSED: Final = 1.0  # regret where a method is not applicable: what is left is the naive observer
RESAMPLES: Final = 2000


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """A method's place.

    median_regret, worst_regret: over scenarios, of the mean over seeds, with 95 % intervals; worst_scenario: where. behind: median over
    scenarios of the difference to the best contestant on the same scenario and seed, with its interval. Of the runs that did
    not diverge: tracking: mean rms of z - r [z]; estimation: mean rms of z - z^ [z]; width, centre: median errors where
    identifiable; coverage: mean; effort, slew: median [u]; None where no run has one. settled, diverged, not_applicable: shares
    of all runs. cost: of a step, in those of the naive observer, median over scenarios.
    """

    method: str
    reference: bool
    median_regret: float
    median_interval: tuple[float, float]
    worst_regret: float
    worst_interval: tuple[float, float]
    worst_scenario: str
    diverged: float
    not_applicable: float
    behind: float
    behind_interval: tuple[float, float]
    settled: float
    tracking: float | None
    estimation: float | None
    width: float | None
    centre: float | None
    coverage: float | None
    effort: float | None
    slew: float | None
    cost: float | None


def regrets(results: Sequence[Result]) -> dict[str, Floats]:
    """Regret (scenarios x seeds) by method: (J - J_full) / (J_naive - J_full), J the rms of z - r, of the same seed; NaN where refused."""
    scenarios, seeds = (
        list(dict.fromkeys(r.scenario for r in results)),
        list(dict.fromkeys(r.seed for r in results)),
    )
    J = {
        name: np.full((len(scenarios), len(seeds)), np.nan)
        for name in dict.fromkeys(r.method for r in results)
    }
    for result in results:
        if result.worth is not None:
            J[result.method][scenarios.index(result.scenario), seeds.index(result.seed)] = (
                np.inf if result.worth.diverged else result.worth.tracking
            )
    full, naive = (J[name] for name in FRAME)
    with np.errstate(invalid="ignore"):
        return {
            name: np.where(np.isnan(own), np.nan, np.fmin((own - full) / (naive - full), CAP))
            for name, own in J.items()
        }


def leaderboard(
    results: Sequence[Result], references: Container[str] = (), seed: int = 0
) -> list[Row]:
    """The methods by median regret, of equals by the worst. Where one is not applicable its regret counts REFUSED."""
    counted = {
        name: np.where(np.isnan(regret), REFUSED, regret)
        for name, regret in regrets(results).items()
    }
    scenarios = list(dict.fromkeys(result.scenario for result in results))
    times = {name: _times(results, name) for name in counted}
    medians = {
        name: (np.median(regret.mean(axis=1)), regret.mean(axis=1).max())
        for name, regret in counted.items()
    }
    best = counted[
        min(
            (name for name in counted if name not in references),
            key=medians.__getitem__,
            default=FRAME[0],
        )
    ]
    rows = []
    for name, regret in counted.items():
        own = [result for result in results if result.method == name]
        (median, worst), (behind, _) = intervals(regret, seed), intervals(regret - best, seed)
        done = [result.worth for result in own if result.worth is not None]
        kept = [worth for worth in done if not worth.diverged]
        ratios = [times[name][scenario] / times[FRAME[1]][scenario] for scenario in times[name]]
        rows.append(
            Row(
                method=name,
                reference=name in references,
                median_regret=median.value,
                median_interval=(median.low, median.high),
                worst_regret=worst.value,
                worst_interval=(worst.low, worst.high),
                worst_scenario=scenarios[int(regret.mean(axis=1).argmax())],
                behind=behind.value,
                behind_interval=(behind.low, behind.high),
                diverged=(len(done) - len(kept)) / len(own),
                not_applicable=1 - len(done) / len(own),
                settled=sum(worth.settling is not None for worth in kept) / len(own),
                cost=float(np.median(ratios)) if ratios else None,
                **{
                    field: _over(kept, field, np.mean)
                    for field in ("tracking", "estimation", "coverage")
                },
                **{
                    field: _over(kept, field, np.median)
                    for field in ("width", "centre", "effort", "slew")
                },
            )
        )
    return sorted(rows, key=lambda row: (row.median_regret, row.worst_regret))


def _over(
    kept: Sequence[Worth], field: str, statistic: Callable[[list[float]], Any]
) -> float | None:
    values = [value for worth in kept if (value := getattr(worth, field)) is not None]
    return float(statistic(values)) if values else None


def _times(results: Sequence[Result], name: str) -> dict[str, float]:
    """Seconds per step by scenario: the least of the seeds, since other work on the machine only adds."""
    found: dict[str, float] = {}
    for result in results:
        if result.method == name and result.worth is not None:
            found[result.scenario] = min(result.worth.cost, found.get(result.scenario, np.inf))
    return found


def intervals(regret: Floats, seed: int = 0) -> tuple[Interval, Interval]:
    """Median and largest over scenarios of the mean over seeds (regret: scenarios x seeds), with their bootstrap intervals.

    Seeds are drawn anew within every scenario; for the median scenarios are too. The worst is that of these very
    scenarios: resampled ones could only leave it out.
    """
    rng = np.random.default_rng(seed)
    rows, columns = regret.shape
    drawn = rng.integers(0, columns, (RESAMPLES, rows, columns))
    means = np.take_along_axis(regret[None], drawn, axis=2).mean(axis=2)
    again = np.take_along_axis(means, rng.integers(0, rows, (RESAMPLES, rows)), axis=1)
    each = regret.mean(axis=1)
    ends = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    return (
        Interval(float(np.median(each)), *np.quantile(np.median(again, axis=1), ends).tolist()),
        Interval(float(each.max()), *np.quantile(means.max(axis=1), ends).tolist()),
    )
