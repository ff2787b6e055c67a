"""The result of tuning: the numbers found, how, and what they are worth on runs that had no part in finding them."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

import undeadzone
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import anchored
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import Tune
from undeadzone.simulation.run import LIMIT
from undeadzone.statistics import intervals as statistics
from undeadzone.statistics.intervals import LEVEL, QUANTILES, Interval
from undeadzone.support import toml
from undeadzone.support.arrays import Floats, finite
from undeadzone.support.files import write_text
from undeadzone.tuning.objective import Objective, statistic
from undeadzone.tuning.parameters import Parameter

Stage = Literal["start", "global", "gradient", "local"]
RESAMPLES: Final = 2000  # of the held-out runs, for the interval of the change
EDGE: Final = 0.01  # share of a range within which a number lies at its end


class Trial(NamedTuple):
    """A candidate: its numbers, what it costs on the runs tuned on (inf: refused), the margin of its certificate, why it was tried."""

    point: tuple[float, ...]
    cost: float
    margin: float
    stage: Stage


class Worth(NamedTuple):
    """What numbers are worth in a scenario: the statistic over the runs that did not diverge, and the share that did."""

    value: Interval
    diverged: Interval


class HeldOut(NamedTuple):
    """Of one scenario, on that many held-out runs (one if nothing differs between runs): the scenario as it is, and tuned."""

    before: Worth
    after: Worth
    runs: int


@dataclasses.dataclass(frozen=True, eq=False)
class Tuned:
    """Scenarios with tuned numbers, and how they were found.

    parameters: what was tuned; values: the numbers found; trials: every candidate, in order; runs: simulated to tune, of every
    candidate in every scenario; seed: of these; seed + 1 is that of `held_out`. cost: of the scenarios as they are and tuned,
    on the runs tuned on. change: of the cost on held-out runs, the same ones for both, with its interval. margin: of the
    certificate, None if none was asked for.
    """

    scenarios: tuple[Scenario, ...]
    what: Tune
    seed: int
    parameters: tuple[Parameter, ...]
    values: tuple[float, ...]
    trials: tuple[Trial, ...]
    runs: int
    cost: tuple[float, float]
    held_out: tuple[HeldOut, ...]
    change: Interval
    margin: float | None

    @property
    def scenario(self) -> Scenario:
        """The tuned scenario, the first of several."""
        return self.scenarios[0]

    @property
    def certified(self) -> bool:
        """Whether the certificate that was asked for holds; True if none was."""
        return self.margin is None or self.margin >= self.what.margin

    @property
    def improved(self) -> bool:
        """Whether held-out runs are better: fewer diverge, or as many and all that is known of the change is an improvement."""
        before, after = (
            sum(getattr(each, name).diverged.value for each in self.held_out)
            for name in ("before", "after")
        )
        better = self.change.value < 0 and (
            self.change.high < 0 or not np.isfinite(self.change.high)
        )
        return after < before or (after == before and better)

    @property
    def at_edge(self) -> list[str]:
        """The tuned numbers that lie at an end of their range: a wider one may do better."""
        return [
            p.name
            for p, value in zip(self.parameters, self.values, strict=True)
            if not EDGE < p.share(value) < 1 - EDGE
        ]

    def save(self, path: str | os.PathLike[str], index: int = 0) -> Path:
        """Write a tuned scenario as TOML, every number exactly; files that it names stay where they are. Raises FileError."""
        path = Path(path)
        before, after = (worth.value.value for worth in self.held_out[index][:2])
        head = (
            f"# Tuned by undeadzone {undeadzone.__version__}: {self.what.statistic} {self.what.metric} {before:.4g} -> {after:.4g} on held-out runs,\n"
            f"# {len(self.trials)} candidates on {self.what.runs} runs each, seed {self.seed}.\n"
        )
        return write_text(
            head
            + toml.dumps(
                anchored(self.scenarios[index], Path(os.path.relpath(Path(), path.parent)))
            ),
            path,
        )

    def summary(self) -> dict[str, Any]:
        """Everything found, ready for JSON; null where there is no bound."""
        ranges = [
            {"name": p.name, "low": p.low, "high": p.high, "log": p.log, "start": p.start}
            for p in self.parameters
        ]
        found = {
            "titles": [scenario.title for scenario in self.scenarios],
            "metric": self.what.metric,
            "statistic": self.what.statistic,
            "confidence": LEVEL,
            "parameters": [
                {**each, "value": value} for each, value in zip(ranges, self.values, strict=True)
            ],
            "at_edge": self.at_edge,
            "seed": self.seed,
            "runs": self.what.runs,
            "budget": self.what.budget,
            "evaluations": len(self.trials),
            "simulated_runs": self.runs,
            "tuning": {"before": self.cost[0], "after": self.cost[1]},
            "held_out": {
                "seed": self.seed + 1,
                "change": self.change._asdict(),
                "scenarios": [
                    {"before": _plain(each.before), "after": _plain(each.after), "runs": each.runs}
                    for each in self.held_out
                ],
            },
            "improved": self.improved,
            "certified": None if self.margin is None else self.certified,
            "margin": self.margin,
            "history": [
                {
                    "values": list(trial.point),
                    "cost": trial.cost,
                    "margin": trial.margin,
                    "stage": trial.stage,
                }
                for trial in self.trials
            ],
        }
        return dict(finite(found))


def judged(
    on: Objective,
    found: tuple[Parameter, ...],
    trials: list[Trial],
    best: Trial,
    seed: int,
    threads: int | None = None,
) -> Tuned:
    """The result of the best of the trials, judged on held-out runs, those of the next seed."""
    scenarios = tuple(on.scenario(k, np.array(best.point)) for k in range(len(on.scenarios)))
    pairs = [
        [resolve_scenario(scenario) for scenario in pair]
        for pair in zip(on.scenarios, scenarios, strict=True)
    ]
    first = [on.losses(k, pair[:1], threads) for k, pair in enumerate(pairs)]
    others = on.redrawn(on.what.held_out, seed + 1)
    lost = [others.losses(k, pair, threads) for k, pair in enumerate(pairs)]
    name = on.what.statistic
    return Tuned(
        scenarios=scenarios,
        what=on.what,
        seed=seed,
        parameters=found,
        values=best.point,
        trials=tuple(trials),
        runs=len(trials) * sum(each.shape[1] for each in first),
        cost=(float(on.scores(first)[0]), best.cost),
        held_out=tuple(
            HeldOut(worth(name, before), worth(name, after), before.size) for before, after in lost
        ),
        change=change(others, lost, seed),
        margin=best.margin if on.what.certified else None,
    )


def _plain(found: Worth) -> dict[str, dict[str, float]]:
    return {name: interval._asdict() for name, interval in found._asdict().items()}


def worth(name: str, lost: Floats) -> Worth:
    """The statistic of losses (runs) with its interval; the largest of the runs bounds the worst of all from below only."""
    kept = np.sort(lost[lost < LIMIT])
    diverged = statistics.proportion(lost.size - kept.size, lost.size)
    if not kept.size:
        return Worth(Interval(np.nan, np.nan, np.nan), diverged)
    if name == "worst":
        return Worth(Interval(float(kept[-1]), float(kept[-1]), np.inf), diverged)
    return Worth(
        statistics.mean(kept) if name == "mean" else statistics.quantile(kept, QUANTILES[name]),
        diverged,
    )


def change(on: Objective, lost: list[Floats], seed: int) -> Interval:
    """What tuning did to the cost, from losses (2 x runs) before and after, between the quantiles of resampled runs.

    A run is drawn with both its losses. Unbounded where resampling says nothing: one run, or the worst of them.
    """
    before, after = on.scores(lost)
    value = float(after - before)
    if on.what.statistic == "worst" or any(each.shape[1] == 1 for each in lost):
        alone = all(each.shape[1] == 1 for each in lost)
        return Interval(value, value, value) if alone else Interval(value, -np.inf, np.inf)
    rng = np.random.default_rng(seed)
    total = np.zeros(RESAMPLES)
    for each, frame in zip(lost, on.frames, strict=True):
        drawn = each[:, rng.integers(0, each.shape[1], (RESAMPLES, each.shape[1]))]
        old, new = statistic(on.what.statistic, drawn)
        total += (new - old) / (frame.one - frame.zero) / len(lost)
    low, high = np.quantile(total, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Interval(value, float(low), float(high))
