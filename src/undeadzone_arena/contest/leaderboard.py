"""Ranks from results: regret in zones, median and worst, with bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from typing import Any, Final

import msgspec
import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.metric import Result, RunMetrics
from undeadzone_studies.statistics.intervals import LEVEL, Interval

ZERO: Final = "informed"  # the line of regret 0
NAIVE: Final = "luenberger"  # used if a method is not applicable
FRAME: Final = (ZERO, "full_state", NAIVE)  # lines that are always there
CAP: Final = 10.0  # regret of a run that diverged, above that of any other
RESAMPLES: Final = 2000
MEANS: Final = ("tracking", "estimation", "coverage")  # of which a row gives the mean over runs
MEDIANS: Final = ("width", "centre", "effort", "slew")  # of which a row gives the median


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """Row of the leaderboard: the numbers of one method.

    Regrets are means over seeds. Intervals are those of 95 % confidence. Errors are those of the
    runs that did not diverge, or None if no run has one.

    Attributes:
        method: its name.
        reference: whether it is a line to compare with, no contestant.
        median_regret: over scenarios.
        median_interval: of the median.
        worst_regret: over scenarios.
        worst_interval: of the worst.
        worst_scenario: title of its worst scenario.
        diverged: share of all runs.
        not_applicable: share of all runs.
        behind: median over scenarios of the difference to the best contestant on the same scenario
            and seed.
        behind_interval: of that.
        settled: share of all runs.
        tracking: mean rms of z - r [z].
        estimation: mean rms of z - z^ [z].
        width: median error of d_r + d_l where identifiable, relative.
        centre: median error of (d_r - d_l)/2 where identifiable, relative to (d_r + d_l)/2.
        coverage: mean share of 95 % intervals that hold the truth.
        effort: median rms of u [u].
        slew: median rms of the change of u per step [u].
        cost: of a step, in those of the naive observer, median over scenarios.
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


def select_contestants(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of contestants (no reference lines) that some scenario accepted."""
    return [row for row in rows if not row.reference and row.not_applicable < 1]


def compute_regrets(results: Sequence[Result]) -> dict[str, Floats]:
    """Compute the regret (scenarios x seeds) [zones] of each method, NaN if it was refused.

    It is (J - J_informed) / zone of the same scenario and seed, J the rms of z - r. Of two
    runs that do not diverge the one with the smaller J has the smaller regret, for any reference
    lines.
    """
    scenarios = list(dict.fromkeys(result.scenario for result in results))
    seeds = list(dict.fromkeys(result.seed for result in results))
    shape = len(scenarios), len(seeds)
    names = dict.fromkeys(result.method for result in results)
    J = {name: np.full(shape, np.nan) for name in names}
    zone = np.ones(shape)
    for result in results:
        if result.worth is not None:
            place = scenarios.index(result.scenario), seeds.index(result.seed)
            J[result.method][place] = np.inf if result.worth.diverged else result.worth.tracking
            zone[place] = result.worth.zone
    least = np.where(np.isfinite(J[ZERO]), J[ZERO], 0.0)
    return {name: compress_regret((own - least) / zone) for name, own in J.items()}


def compress_regret(regret: Floats) -> Floats:
    """Return a regret unchanged up to half of `CAP`, and compressed towards `CAP` beyond.

    The order stays, and CAP itself is left to runs that diverged.
    """
    half = CAP / 2
    size = np.maximum(np.abs(regret), half)
    return np.where(np.abs(regret) <= half, regret, np.sign(regret) * (CAP - half**2 / size))


def rank_methods(results: Sequence[Result], references: Container[str] = ()) -> list[Row]:
    """Sort the methods by median regret, and equals by the worst.

    If a method is not applicable, the regret of the naive observer counts.

    Args:
        results: of the runs.
        references: names of the methods that are lines to compare with.
    """
    found = compute_regrets(results)
    counted = {
        name: np.where(np.isnan(regret), found[NAIVE], regret) for name, regret in found.items()
    }
    scenarios = list(dict.fromkeys(result.scenario for result in results))
    best = counted[_best_contestant(counted, references)]
    naive = _step_times(results, NAIVE)
    rows = []
    for name, regret in counted.items():
        own = [result for result in results if result.method == name]
        median, worst = regret_intervals(regret)
        behind, _ = regret_intervals(regret - best)
        times = _step_times(results, name)
        ratios = [times[scenario] / naive[scenario] for scenario in times]
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
                cost=float(np.median(ratios)) if ratios else None,
                **_average_fields(own),
            )
        )
    return sorted(rows, key=lambda row: (row.median_regret, row.worst_regret))


def _best_contestant(counted: Mapping[str, Floats], references: Container[str]) -> str:
    """Return the contestant of least median regret, and of equals that of least worst regret."""
    best = ZERO
    least = (np.inf, np.inf)
    for name, regret in counted.items():
        each = regret.mean(axis=1)
        place = (float(np.median(each)), float(each.max()))
        if name not in references and place < least:
            best = name
            least = place
    return best


def _average_fields(results: Sequence[Result]) -> dict[str, Any]:
    """Return the averages and shares of a method's runs, by the fields of `Row`.

    Averages leave out runs that diverged or that the method does not apply to.
    """
    applicable = [result.worth for result in results if result.worth is not None]
    converged = [metrics for metrics in applicable if not metrics.diverged]
    settled = [metrics for metrics in converged if metrics.settling is not None]
    total = len(results)
    return {
        "diverged": (len(applicable) - len(converged)) / total,
        "not_applicable": 1 - len(applicable) / total,
        "settled": len(settled) / total,
        **{field: _statistic_over_runs(converged, field, np.mean) for field in MEANS},
        **{field: _statistic_over_runs(converged, field, np.median) for field in MEDIANS},
    }


def _statistic_over_runs(
    converged: Sequence[RunMetrics], field: str, statistic: Callable[[list[float]], Any]
) -> float | None:
    """Return a statistic of a field over the runs that have a value, or None if no run has."""
    all_values = [getattr(metrics, field) for metrics in converged]
    values = [value for value in all_values if value is not None]
    return float(statistic(values)) if values else None


def _step_times(results: Sequence[Result], name: str) -> dict[str, float]:
    """Return the seconds per step by scenario: the least of the seeds. Other load only adds."""
    times: dict[str, float] = {}
    for result in results:
        if result.method == name and result.worth is not None:
            before = times.get(result.scenario, np.inf)
            times[result.scenario] = min(result.worth.cost, before)
    return times


def regret_intervals(regret: Floats, seed: int = 0) -> tuple[Interval, Interval]:
    """Return median and maximum, over scenarios, of the mean over seeds, with intervals.

    The intervals are from the bootstrap.

    Seeds are drawn anew within every scenario, and for the median the scenarios too. The worst is
    that of these very scenarios: resampled ones could only leave it out.

    Args:
        regret: (scenarios x seeds).
        seed: of the resampling.
    """
    rng = np.random.default_rng(seed)
    rows, columns = regret.shape
    drawn = rng.integers(0, columns, (RESAMPLES, rows, columns))
    means = np.take_along_axis(regret[None], drawn, axis=2).mean(axis=2)
    again = np.take_along_axis(means, rng.integers(0, rows, (RESAMPLES, rows)), axis=1)
    each = regret.mean(axis=1)
    ends = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    median_ends = np.quantile(np.median(again, axis=1), ends).tolist()
    worst_ends = np.quantile(means.max(axis=1), ends).tolist()
    return (
        Interval(float(np.median(each)), *median_ends),
        Interval(float(each.max()), *worst_ends),
    )
