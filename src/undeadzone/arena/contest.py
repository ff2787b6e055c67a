"""A contest: results, the places that they give, and what both rest on, ready for a file or a page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

import undeadzone
from undeadzone.arena.leaderboard import CAP, FRAME, REFUSED, RESAMPLES, Row, leaderboard, regrets
from undeadzone.arena.methods import NOTHING, Numbers, catalogue, entered
from undeadzone.arena.metric import TAIL, Result
from undeadzone.arena.prior_knowledge import situation
from undeadzone.arena.trials import score, signals
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Outputs
from undeadzone.statistics.intervals import LEVEL
from undeadzone.support.arrays import finite
from undeadzone.support.files import write_text


class Contest(NamedTuple):
    """scenarios by name; numbers: of the knobs, by method; rows: the leaderboard."""

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
        """A scenario with a method in the place of its observer, its knobs as they were here. Raises InputError where it is not applicable."""
        return entered(
            catalogue()[method], situation(self.scenarios[title]), self.numbers.get(method, NOTHING)
        )

    def replay(self, method: str, title: str) -> tuple[Problem, Outputs]:
        """A run again, with the first seed, and all its signals."""
        problem = resolve_scenario(self.scenario(method, title))
        return problem, signals(problem, self.seeds[0])

    def summary(self) -> dict[str, Any]:
        """Everything, ready for JSON; null where there is no number."""
        found = regrets(self.results)
        places = {title: i for i, title in enumerate(self.scenarios)}

        def flat(result: Result) -> dict[str, Any]:
            regret = float(
                found[result.method][places[result.scenario], self.seeds.index(result.seed)]
            )
            worth = {} if result.worth is None else msgspec.structs.asdict(result.worth)
            known = {
                "method": result.method,
                "scenario": result.scenario,
                "seed": result.seed,
                "applicable": result.worth is not None,
            }
            return known | {"reason": result.reason, "regret": regret} | worth

        rules = {
            "tail": TAIL,
            "cap": CAP,
            "refused": REFUSED,
            "resamples": RESAMPLES,
            "confidence": LEVEL,
            "zero": FRAME[0],
            "one": FRAME[1],
        }
        return dict(
            finite(
                {
                    "version": undeadzone.__version__,
                    "scenarios": {
                        title: scenario.title for title, scenario in self.scenarios.items()
                    },
                    "seeds": list(self.seeds),
                    "rules": rules,
                    "leaderboard": [msgspec.structs.asdict(row) for row in self.rows],
                    "results": [flat(result) for result in self.results],
                }
            )
        )

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
    """Methods (None: all) against each other on scenarios. Raises InputError and its kinds."""
    results = score(
        methods, scenarios, seeds, numbers=numbers, processes=processes, progress=progress
    )
    references = {name for name, method in catalogue().items() if method.reference}
    return Contest(scenarios, tuple(seeds), numbers, results, leaderboard(results, references))
