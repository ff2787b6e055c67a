"""From results to ranks: regret against two lines, median and worst over scenarios, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np

from undeadzone.arena.metric import Result
from undeadzone.arrays import Floats
from undeadzone.ensemble.statistics import LEVEL, Interval

FRAME: Final = ("full_state", "luenberger")  # regret 0 and 1
CAP: Final = 10.0  # regret of a run that diverged, and the largest of any
REFUSED: Final = 1.0  # regret where a method is not applicable: what is left is the naive observer
RESAMPLES: Final = 2000


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """A method's place.

    median_regret, worst_regret: over scenarios, of the mean over seeds, with their intervals; estimation, width, centre, coverage, cost:
    medians (coverage: mean) over the runs that have one; diverged, not_applicable: shares of all runs.
    """

    method: str
    median_regret: float
    median_interval: tuple[float, float]
    worst_regret: float
    worst_interval: tuple[float, float]
    worst_scenario: str
    diverged: float
    not_applicable: float
    estimation: float | None
    width: float | None
    centre: float | None
    coverage: float | None
    settled: float
    cost: float | None


def regrets(results: Sequence[Result]) -> dict[str, Floats]:
    """Regret (scenarios x seeds) by method: (J - J_full) / (J_naive - J_full), J the rms of z - r, of the same seed; NaN where refused."""
    scenarios, seeds = list(dict.fromkeys(r.scenario for r in results)), list(dict.fromkeys(r.seed for r in results))
    J = {name: np.full((len(scenarios), len(seeds)), np.nan) for name in dict.fromkeys(r.method for r in results)}
    for result in results:
        if result.worth is not None:
            J[result.method][scenarios.index(result.scenario), seeds.index(result.seed)] = np.inf if result.worth.diverged else result.worth.tracking
    full, naive = (J[name] for name in FRAME)
    with np.errstate(invalid="ignore"):
        return {name: np.where(np.isnan(own), np.nan, np.fmin((own - full) / (naive - full), CAP)) for name, own in J.items()}


def leaderboard(results: Sequence[Result], seed: int = 0) -> list[Row]:
    """The methods by median regret. Where one is not applicable its regret counts REFUSED."""
    by_method: dict[str, list[Result]] = {}
    for result in results:
        by_method.setdefault(result.method, []).append(result)
    found = regrets(results)
    scenarios = list(dict.fromkeys(r.scenario for r in results))
    return sorted((_row(name, found[name], own, scenarios, by_method[FRAME[1]], seed) for name, own in by_method.items()), key=lambda row: row.median_regret)


def _row(name: str, regret: Floats, own: Sequence[Result], scenarios: list[str], naive: Sequence[Result], seed: int) -> Row:
    counted = np.where(np.isnan(regret), REFUSED, regret)
    each = counted.mean(axis=1)
    done = [r.worth for r in own if r.worth is not None]

    def typical(field: str) -> float | None:
        values = [value for worth in done if not worth.diverged and (value := getattr(worth, field)) is not None]
        return None if not values else float(np.mean(values) if field == "coverage" else np.median(values))

    costs = {(r.scenario, r.seed): r.worth.cost for r in naive if r.worth is not None}
    ratios = [r.worth.cost / costs[r.scenario, r.seed] for r in own if r.worth is not None]
    median, worst = intervals(counted, seed)
    return Row(
        method=name,
        median_regret=median.value,
        median_interval=(median.low, median.high),
        worst_regret=worst.value,
        worst_interval=(worst.low, worst.high),
        worst_scenario=scenarios[int(each.argmax())],
        diverged=sum(worth.diverged for worth in done) / len(own),
        not_applicable=1 - len(done) / len(own),
        settled=sum(worth.settling is not None for worth in done) / len(own),
        cost=float(np.median(ratios)) if ratios else None,
        **{field: typical(field) for field in ("estimation", "width", "centre", "coverage")},
    )


def intervals(regret: Floats, seed: int = 0) -> tuple[Interval, Interval]:
    """Median and worst over scenarios of the mean over seeds (regret: scenarios x seeds), with their bootstrap intervals.

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
