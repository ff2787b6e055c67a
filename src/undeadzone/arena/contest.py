"""A contest: results, the places that they give, and what both rest on, for a file or a page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

import undeadzone
from undeadzone.arena.entry import entered
from undeadzone.arena.leaderboard import (
    CAP,
    NAIVE,
    RESAMPLES,
    ZERO,
    Row,
    leaderboard,
    regrets,
)
from undeadzone.arena.methods import NOTHING, Numbers, catalogue
from undeadzone.arena.metric import TAIL, Result
from undeadzone.arena.prior_knowledge import situation
from undeadzone.arena.trials import score, signals
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Outputs
from undeadzone.statistics.intervals import LEVEL
from undeadzone.support.arrays import finite
from undeadzone.support.files import write_text

RULES: Mapping[str, Any] = {
    "tail": TAIL,
    "cap": CAP,
    "refused": NAIVE,
    "resamples": RESAMPLES,
    "confidence": LEVEL,
    "zero": ZERO,
    "unit": "half of d_r + d_l",
}


class Contest(NamedTuple):
    """A contest of methods on scenarios.

    Attributes:
        scenarios: by name.
        seeds: of the runs of each method on each scenario.
        numbers: of the knobs, by method.
        results: one for each run.
        rows: the leaderboard.
    """

    scenarios: Mapping[str, Scenario]
    seeds: tuple[int, ...]
    numbers: Numbers
    results: list[Result]
    rows: list[Row]

    @property
    def contestants(self) -> list[Row]:
        """The rows that are no lines to compare with, and could be entered somewhere."""
        return [row for row in self.rows if not row.reference and row.not_applicable < 1]

    def scenario(self, method: str, title: str) -> Scenario:
        """A scenario with a method in the place of its observer, its knobs as they were here.

        Args:
            method: name in the catalogue.
            title: name of the scenario.

        Raises:
            InputError: or a subclass, where the method is not applicable.
        """
        numbers = self.numbers.get(method, NOTHING)
        return entered(catalogue()[method], situation(self.scenarios[title]), numbers)

    def replay(self, method: str, title: str) -> tuple[Problem, Outputs]:
        """A run again, with the first seed, and all its signals.

        Args:
            method: name in the catalogue.
            title: name of the scenario.
        """
        problem = resolve_scenario(self.scenario(method, title))
        return problem, signals(problem, self.seeds[0])

    def summary(self) -> dict[str, Any]:
        """Everything, ready for JSON; null where there is no number."""
        titles = {name: scenario.title for name, scenario in self.scenarios.items()}
        return dict(
            finite(
                {
                    "version": undeadzone.__version__,
                    "scenarios": titles,
                    "seeds": list(self.seeds),
                    "rules": dict(RULES),
                    "leaderboard": [msgspec.structs.asdict(row) for row in self.rows],
                    "results": self._flat_results(),
                }
            )
        )

    def _flat_results(self) -> list[dict[str, Any]]:
        """The results with their regrets, each as one dictionary."""
        regret = regrets(self.results)
        places = {title: i for i, title in enumerate(self.scenarios)}
        flat = []
        for result in self.results:
            row, column = places[result.scenario], self.seeds.index(result.seed)
            worth = {} if result.worth is None else msgspec.structs.asdict(result.worth)
            flat.append(
                {
                    "method": result.method,
                    "scenario": result.scenario,
                    "seed": result.seed,
                    "applicable": result.worth is not None,
                    "reason": result.reason,
                    "regret": float(regret[result.method][row, column]),
                    **worth,
                }
            )
        return flat

    def save(self, path: Path) -> Path:
        """Write the summary as JSON. Raises FileError."""
        return write_text(json.dumps(self.summary(), indent=1, allow_nan=False), path)


def run_contest(
    methods: Sequence[str] | None,
    scenarios: Mapping[str, Scenario],
    seeds: Sequence[int],
    numbers: Numbers,
    processes: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Contest:
    """Let methods run against each other on scenarios.

    Args:
        methods: names in the catalogue; None: all.
        scenarios: by name.
        seeds: of the runs of each method on each scenario.
        numbers: of the knobs, by method.
        processes: at once; None: one per processor.
        progress: called with the number of runs just done.

    Raises:
        InputError: or a subclass.
    """
    results = score(
        methods, scenarios, seeds, numbers=numbers, processes=processes, progress=progress
    )
    references = {name for name, method in catalogue().items() if method.reference}
    return Contest(scenarios, tuple(seeds), numbers, results, leaderboard(results, references))
