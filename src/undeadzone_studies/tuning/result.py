"""Result of tuning: the numbers, the search, and their cost on held-out runs."""

from __future__ import annotations

import dataclasses
import os
from itertools import starmap
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

import undeadzone
from undeadzone.results.scales import LIMIT
from undeadzone.results.sheet import format_number
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import anchor_files
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.util import shown, toml
from undeadzone.util.arrays import Floats, to_json_value
from undeadzone.util.files import to_path, write_text
from undeadzone.util.own_files import mark_toml
from undeadzone_studies.statistics import intervals as statistics
from undeadzone_studies.statistics.intervals import LEVEL, QUANTILES, Interval
from undeadzone_studies.tuning.candidates import Objective, loss_statistic
from undeadzone_studies.tuning.parameters import Parameter

RESAMPLES: Final = 2000  # of the held-out runs, for the interval of the change
EDGE: Final = 0.01  # share of a range within which a number lies at its end


class SimulatedCandidate(NamedTuple):
    """Candidate with its simulated cost.

    Attributes:
        values: its numbers
        cost: on the runs tuned on (inf if it was refused)
        margin: of its certificate (inf if none was required)
        stage: of the search that came upon it
    """

    values: tuple[float, ...]
    cost: float
    margin: float
    stage: str


class HeldOutCost(NamedTuple):
    """Cost of numbers in a scenario.

    Attributes:
        value: the statistic over the runs that did not diverge
        diverged: the share of runs that did
    """

    value: Interval
    diverged: Interval


class HeldOut(NamedTuple):
    """Effect of tuning in one scenario on held-out runs.

    Attributes:
        before: score of the scenario as it is
        after: score of the tuned one
        runs: how many (one if nothing differs between runs)
    """

    before: HeldOutCost
    after: HeldOutCost
    runs: int


@dataclasses.dataclass(frozen=True, eq=False)
class Tuned:
    """Scenarios with tuned numbers, and the record of the search.

    Attributes:
        scenarios: the tuned scenarios
        what: the table [tune]
        seed: of the runs tuned on (seed + 1 is that of `held_out`)
        parameters: tuned numbers
        values: the numbers found
        trials: every candidate, in order
        runs: simulated to tune, of every candidate in every scenario
        cost: of the scenarios as they are and tuned, on the runs tuned on
        held_out: of each scenario
        change: of the cost on held-out runs, the same ones before and after
        margin: of the certificate (None if none was required)
    """

    scenarios: tuple[Scenario, ...]
    what: Tune
    seed: int
    parameters: tuple[Parameter, ...]
    values: tuple[float, ...]
    trials: tuple[SimulatedCandidate, ...]
    runs: int
    cost: tuple[float, float]
    held_out: tuple[HeldOut, ...]
    change: Interval
    margin: float | None

    @property
    def drawn(self) -> tuple[str, str, str]:
        """Return module and functions that draw the search for `uz.plot`."""
        return "undeadzone_studies.report.tune_page", "history", "candidates"

    @property
    def scenario(self) -> Scenario:
        """Return the tuned scenario, the first of several."""
        return self.scenarios[0]

    @property
    def certified(self) -> bool:
        """Return whether a required certificate holds, or True if none was required."""
        return self.margin is None or self.margin >= self.what.margin

    @property
    def improved(self) -> bool:
        """Return whether held-out runs are better.

        Fewer diverge, or as many and all that is known of the change is an improvement.
        """
        before = sum(each.before.diverged.value for each in self.held_out)
        after = sum(each.after.diverged.value for each in self.held_out)
        change = self.change
        cheaper = change.value < 0 and (change.high < 0 or not np.isfinite(change.high))
        return after < before or (after == before and cheaper)

    @property
    def at_edge(self) -> list[str]:
        """Return the tuned numbers that lie at an end of their range: a wider range may do
        better.
        """
        pairs = zip(self.parameters, self.values, strict=True)
        return [p.name for p, value in pairs if not EDGE < p.share_of_range(value) < 1 - EDGE]

    def blocks(self) -> list[shown.Block]:
        """Return the tables that `undeadzone tune` prints."""
        return [describe_tuning(self)]

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html

    plot = shown.plot
    """Draw it."""

    def save(self, path: str | os.PathLike[str], index: int = 0) -> Path:
        """Write a tuned scenario as TOML, every number exactly.

        Files that the scenario names stay in their place.

        Args:
            path: of the file
            index: of the scenario

        Returns:
            The path.

        Raises:
            FileError: if it cannot be written
        """
        path = to_path(path)
        before, after = (worth.value.value for worth in self.held_out[index][:2])
        head = (
            f"# Tuned by undeadzone {undeadzone.__version__}: "
            f"{self.what.statistic} {self.what.metric} {before:.4g} -> {after:.4g} "
            "on held-out runs,\n"
            f"# {len(self.trials)} candidates on {self.what.runs} runs each, seed {self.seed}.\n"
        )
        here = Path(os.path.relpath(Path(), path.parent))  # from the file's folder
        return write_text(
            mark_toml(head + toml.to_toml(anchor_files(self.scenarios[index], here))), path
        )

    def summary(self) -> dict[str, Any]:
        """Return all results, ready for JSON.

        Returns:
            Tuned numbers, method, costs, held-out runs and every candidate (null without a bound).
        """
        keys = ("name", "low", "high", "log", "start")
        parameters = []
        for parameter, value in zip(self.parameters, self.values, strict=True):
            parameters.append({key: getattr(parameter, key) for key in keys} | {"value": value})
        summary = {
            "titles": [scenario.title for scenario in self.scenarios],
            "metric": self.what.metric,
            "statistic": self.what.statistic,
            "confidence": LEVEL,
            "parameters": parameters,
            "at_edge": self.at_edge,
            "seed": self.seed,
            "runs": self.what.runs,
            "budget": self.what.budget,
            "evaluations": len(self.trials),
            "simulated_runs": self.runs,
            "tuning": {"before": self.cost[0], "after": self.cost[1]},
            "held_out": {
                "seed": self.seed + 1,
                "change": self.change,
                "scenarios": self.held_out,
            },
            "improved": self.improved,
            "certified": None if self.margin is None else self.certified,
            "margin": self.margin,
            "history": self.trials,
        }
        return dict(to_json_value(summary))


def describe_tuning(found: Tuned) -> dict[str, Any]:
    """Return the result of tuning as text, by topic."""
    what = found.what
    summary: dict[str, Any] = {
        "scenario": found.scenario.title,
        "made small": (
            f"{what.statistic} of {what.metric}, {what.runs} runs, "
            f"{len(found.trials)} candidates of {what.budget}"
        ),
    }
    for parameter, value in zip(found.parameters, found.values, strict=True):
        words = f"{value:.6g} (from {parameter.start:.6g})"
        if parameter.name in found.at_edge:
            words += ", at the end of its range: a wider one may do better"
        summary[parameter.name] = words
    summary |= _describe_improvement(found)
    if to_json_value(found.margin) is not None:
        yes_no = "yes" if found.certified else "NO"
        summary["certified"] = f"{yes_no}, margin {found.margin:.4g}"
    return summary


def _describe_improvement(found: Tuned) -> dict[str, str]:
    """Return the gain by tuning, on the runs tuned on and on held-out runs."""
    before, after, runs = found.held_out[0]
    drawn = f"{runs} runs" if runs > 1 else "one run: nothing differs between them"
    verdict = "better" if found.improved else "NO improvement that chance could not explain"
    summary = {
        "runs tuned on": " -> ".join(map(_format_known_number, found.cost)),
        "held-out runs": f"{_format_cost_interval(before.value)} -> "
        f"{_format_cost_interval(after.value)}, {drawn}",
        "change": f"{_format_cost_interval(found.change)}: {verdict}",
    }
    lost = before.diverged.value, after.diverged.value
    if any(lost):
        summary["diverged"] = f"{100 * lost[0]:.3g} % -> {100 * lost[1]:.3g} % of the held-out runs"
    return summary


def _format_cost_interval(interval: Interval) -> str:
    """Return a value and its interval, with an unknown end as "?"."""
    value, low, high = map(_format_known_number, interval)
    return f"{value} [{low}, {high}]"


def _format_known_number(value: float) -> str:
    """Return a number as text, or "?" if it is not known."""
    return format_number(to_json_value(value), none="?")


def choose_best(candidates: list[SimulatedCandidate], least: float) -> SimulatedCandidate:
    """Return the cheapest candidate with the certificate, else that of the largest margin.

    Args:
        candidates: one at least
        least: margin of a certificate
    """
    certified = [each for each in candidates if each.margin >= least]
    if certified:
        return min(certified, key=lambda candidate: candidate.cost)
    return max(candidates, key=lambda candidate: candidate.margin)


def validate_best(
    on: Objective, tuned: tuple[Parameter, ...], candidates: list[SimulatedCandidate], seed: int
) -> Tuned:
    """Return the result of tuning: the cost of the best candidate on held-out runs, of the
    next seed.

    Args:
        on: the objective
        tuned: tuned numbers
        candidates: those simulated, in order
        seed: of the runs tuned on
    """
    best = choose_best(candidates, on.what.margin)
    name = on.what.statistic
    scenarios = tuple(
        on.candidate_scenario(k, np.array(best.values)) for k in range(len(on.scenarios))
    )
    before_and_after = zip(on.scenarios, scenarios, strict=True)
    pairs = [list(map(resolve_scenario, pair)) for pair in before_and_after]
    lost_as_is = [on.candidate_losses(k, pair[:1]) for k, pair in enumerate(pairs)]
    others = on.redraw_test_runs(on.what.held_out, seed + 1)
    lost = list(starmap(others.candidate_losses, enumerate(pairs)))
    return Tuned(
        scenarios=scenarios,
        what=on.what,
        seed=seed,
        parameters=tuned,
        values=best.values,
        trials=tuple(candidates),
        runs=len(candidates) * sum(each.shape[1] for each in lost_as_is),
        cost=(float(on.mean_scores(lost_as_is)[0]), best.cost),
        held_out=tuple(
            HeldOut(estimate_cost(name, old), estimate_cost(name, new), old.size)
            for old, new in lost
        ),
        change=estimate_change(others, lost, seed),
        margin=best.margin if on.what.certified else None,
    )


def estimate_cost(name: str, lost: Floats) -> HeldOutCost:
    """Return the statistic of losses (runs) with its interval.

    The largest of the runs bounds the worst of all runs from below only.
    """
    bounded = np.sort(lost[lost < LIMIT])
    diverged = statistics.proportion(lost.size - bounded.size, lost.size)
    if not bounded.size:
        return HeldOutCost(Interval(np.nan, np.nan, np.nan), diverged)
    if name == "worst":
        return HeldOutCost(Interval(float(bounded[-1]), float(bounded[-1]), np.inf), diverged)
    if name == "mean":
        return HeldOutCost(statistics.mean_interval(bounded), diverged)
    return HeldOutCost(statistics.quantile_interval(bounded, QUANTILES[name]), diverged)


def estimate_change(on: Objective, lost: list[Floats], seed: int) -> Interval:
    """Return the change of the cost by tuning, between the quantiles of resampled runs.

    A run is drawn with both its losses. The interval is unbounded if resampling gives no bound: for
    one run, or the worst of them.

    Args:
        on: the objective
        lost: losses before and after (2 x runs) in each scenario
        seed: of the resampling
    """
    before, after = on.mean_scores(lost)
    value = float(after - before)
    if on.what.statistic == "worst" or any(each.shape[1] == 1 for each in lost):
        alone = all(each.shape[1] == 1 for each in lost)
        return Interval(value, value, value) if alone else Interval(value, -np.inf, np.inf)
    rng = np.random.default_rng(seed)
    total = np.zeros(RESAMPLES)
    for each, frame in zip(lost, on.frames, strict=True):
        runs = each.shape[1]
        resampled = each[:, rng.integers(0, runs, (RESAMPLES, runs))]
        old, new = loss_statistic(on.what.statistic, resampled)
        total += (new - old) / (frame.one - frame.zero) / len(lost)
    low, high = np.quantile(total, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(value, float(low), float(high))
