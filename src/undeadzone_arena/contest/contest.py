"""Contest: results, ranks, and the data that both depend on, for a file or a page."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec

import undeadzone
from undeadzone.errors import InputError
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Outputs
from undeadzone.util import shown
from undeadzone.util.answers import open_answers
from undeadzone.util.arrays import to_json_value
from undeadzone.util.files import write_text
from undeadzone.util.progress import notebook_progress
from undeadzone.util.shown import Block
from undeadzone_arena.contest.entry import enter_method, read_knob_numbers
from undeadzone_arena.contest.leaderboard import (
    CAP,
    NAIVE,
    RESAMPLES,
    ZERO,
    Row,
    compute_regrets,
    rank_methods,
    select_contestants,
)
from undeadzone_arena.contest.methods import (
    NOTHING,
    RECOMMENDED,
    Method,
    Numbers,
    method_from_options,
    method_registry,
    require_method,
)
from undeadzone_arena.contest.metric import TAIL, Result
from undeadzone_arena.contest.prior_knowledge import build_setting
from undeadzone_arena.contest.scenario_sets import arena_scenarios as held_out
from undeadzone_arena.contest.trials import result_dependencies, score_methods, trial_signals
from undeadzone_arena.contest.words import leaderboard_blocks
from undeadzone_studies.statistics.intervals import LEVEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RULES: Mapping[str, Any] = {
    "tail": TAIL,
    "cap": CAP,
    "refused": NAIVE,
    "resamples": RESAMPLES,
    "confidence": LEVEL,
    "zero": ZERO,
    "unit": "half of d_r + d_l",
}

TIMED: Final = ("leaderboard", "results")  # tables of the summary, with a cost a row


class Contest(NamedTuple):
    """Contest of methods on scenarios.

    Attributes:
        scenarios: by name.
        seeds: of the runs of each method on each scenario.
        numbers: of the knobs, by method.
        results: one for each run.
        rows: the leaderboard.
        own: methods of one's own, that the catalogue does not hold, by name.
    """

    scenarios: Mapping[str, Scenario]
    seeds: tuple[int, ...]
    numbers: Numbers
    results: list[Result]
    rows: list[Row]
    own: Mapping[str, Method] = NOTHING

    @property
    def contestants(self) -> list[Row]:
        """Return the rows of contestants (no reference lines) that some scenario accepted."""
        return select_contestants(self.rows)

    def scenario(self, method: str, title: str) -> Scenario:
        """Return a scenario with a method as its observer, with the knobs of this contest.

        Args:
            method: name in the catalogue, or of one's own.
            title: name of the scenario.

        Raises:
            InputError: or a subclass, if the method is not applicable.
        """
        numbers = self.numbers.get(method, NOTHING)
        known = {**method_registry(), **self.own}
        return enter_method(known[method], build_setting(self.scenarios[title]), numbers)

    def replay(self, method: str, title: str) -> tuple[Problem, Outputs]:
        """Repeat a run with the first seed, and return the problem and all signals.

        Args:
            method: name in the catalogue.
            title: name of the scenario.
        """
        problem = resolve_scenario(self.scenario(method, title))
        return problem, trial_signals(problem, self.seeds[0])

    @property
    def drawn(self) -> tuple[str, str, str]:
        """Return module and functions that draw the contest for `uz.plot`."""
        return "undeadzone_arena.contest.page", "plot_first_figure", "panel"

    def summary(self) -> dict[str, Any]:
        """Return all numbers, ready for JSON, with null for a missing number."""
        titles = {name: scenario.title for name, scenario in self.scenarios.items()}
        return dict(
            to_json_value(
                {
                    "version": undeadzone.__version__,
                    "scenarios": titles,
                    "seeds": list(self.seeds),
                    "rules": dict(RULES),
                    "leaderboard": list(map(msgspec.structs.asdict, self.rows)),
                    "results": self._flat_results(),
                }
            )
        )

    def _flat_results(self) -> list[dict[str, Any]]:
        """Return the results with their regrets, each as one dictionary."""
        regret = compute_regrets(self.results)
        places = {title: i for i, title in enumerate(self.scenarios)}
        flat = []
        for result in self.results:
            row = places[result.scenario]
            column = self.seeds.index(result.seed)
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

    def __repr__(self) -> str:
        """Return the leaderboard that `undeadzone arena` prints."""
        return shown.format_result(self)

    def _repr_html_(self) -> str:
        """Return leaderboard and figure for a notebook."""
        return shown.result_to_html(self)

    def blocks(self) -> list[Block]:
        """Return the tables that `undeadzone arena` prints."""
        reasons = {result.method: result.reason or "" for result in reversed(self.results)}
        return leaderboard_blocks(self.rows, len(self.scenarios), len(self.seeds), reasons)

    def plot(self, path: str | os.PathLike[str] | None = None, ax: Axes | None = None) -> Figure:
        """Draw the contest.

        Args:
            path: the file to write, a PNG, PDF or SVG by its suffix (None writes none).
            ax: axes that take the most informative panel (None: a new figure with all panels).
        """
        return shown.plot(self, path, ax)

    def save(self, path: Path) -> list[Path]:
        """Write the summary as JSON, and the measured times as `costs.json` beside it.

        So two contests over the same scenarios and seeds have the same results, to the last byte.

        Raises:
            FileError: it cannot be written.
        """
        summary = self.summary()
        costs = {key: [row.pop("cost", None) for row in summary[key]] for key in TIMED}
        return [_write_json(summary, path), _write_json(costs, path.with_name("costs.json"))]


def _write_json(value: Any, path: Path) -> Path:
    """Write a value as JSON. Raises FileError."""
    return write_text(json.dumps(value, indent=1, allow_nan=False), path)


def arena(
    scenarios: Mapping[str, Scenario] | Sequence[Scenario] | None = None,
    also: Mapping[str, Any] | None = None,
    *,
    methods: Sequence[str] | None = None,
    seeds: Sequence[int] = (0, 1, 2),
    processes: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Contest:
    """Run methods against each other, a user's own included (docs/arena.md).

    Args:
        scenarios: by name, or in a list, whose titles name them (None: those that the arena holds
            out). Each method takes the place of their observer.
        also: options of your own observers by name, `{"mine": Mine()}` (options left out are filled
            with those that the scenario declares, as for every method).
        methods: names in the catalogue (None: all that fit, or with `also` the recommended ones).
        seeds: of the runs of each method on each scenario.
        processes: at once (None: one per processor, and one alone with `also`).
        progress: called with the number of runs just done (None: a bar in a notebook).

    Returns:
        The contest. `uz.plot(contest)` draws it, `contest.save("results.json")` keeps it.

    Raises:
        InputError: there is no such method, or a name of your own is one of the catalogue's.
    """
    if scenarios is None:
        grounds: Mapping[str, Scenario] = held_out("held_out")
    elif isinstance(scenarios, Mapping):
        grounds = scenarios
    else:
        grounds = {scenario.title: scenario for scenario in scenarios}
    own = {name: method_from_options(options) for name, options in (also or {}).items()}
    known = method_registry()
    for name in own:
        if name in known:
            raise InputError(f"also: {name!r} is in the catalogue. Give your method another name")
    names = RECOMMENDED if methods is None and own else methods
    entries: Sequence[str] | Mapping[str, Method] | None = names
    if own:
        entries = {name: known[require_method(name)] for name in names or ()} | own
    return run_contest(entries, grounds, seeds, read_knob_numbers(), processes, progress)


def run_contest(
    methods: Sequence[str] | Mapping[str, Method] | None,
    scenarios: Mapping[str, Scenario],
    seeds: Sequence[int],
    numbers: Numbers,
    processes: int | None,
    progress: Callable[[int], None] | None = None,
    keep: Path | None = None,
    resume: bool = False,
) -> Contest:
    """Run methods against each other on scenarios.

    Args:
        methods: names in the catalogue, or methods by name (None: all).
        scenarios: by name.
        seeds: of the runs of each method on each scenario.
        numbers: of the knobs, by method.
        processes: at once (None: one per processor).
        progress: called with the number of runs just done (None: a bar in a notebook).
        keep: file that keeps results, to be deleted once the contest is saved (None: none).
        resume: continue a stopped contest from the results in `keep`.

    Raises:
        InputError: or a subclass.
    """
    describe = functools.partial(result_dependencies, scenarios, seeds, numbers)
    with (
        notebook_progress(progress, "arena", None) as advance,
        open_answers(keep, describe, "results", resume) as saved_results,
    ):
        results = score_methods(
            methods,
            scenarios,
            seeds,
            numbers=numbers,
            processes=processes,
            progress=advance,
            saved_results=saved_results,
        )
    references = {name for name, method in method_registry().items() if method.reference}
    rows = rank_methods(results, references)
    own = methods if isinstance(methods, Mapping) else NOTHING
    return Contest(scenarios, tuple(seeds), numbers, results, rows, own)
