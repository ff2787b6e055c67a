"""Amount of work of a contest, printed before it starts."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Final

from undeadzone.scenario.schema import Scenario
from undeadzone.util.text import count_noun
from undeadzone_arena.contest.leaderboard import NAIVE
from undeadzone_arena.contest.methods import method_registry
from undeadzone_arena.contest.prior_knowledge import Setting, build_settings
from undeadzone_arena.contest.trials import process_count, run_trial

# Time of a run, as a multiple of the naive observer's: `python -m benchmarks arena_effort`.
HEAVY: Final[Mapping[str, float]] = {
    "moving_horizon": 68.0,
    "particle_filter": 65.0,
    "censored": 24.0,
    "auto": 23.0,
    "printed": 7.0,
    "printed_fed": 7.0,
}
USUAL: Final = 2.0  # the same for all other methods


def effort_text(
    names: Sequence[str],
    scenarios: Mapping[str, Scenario],
    runs: int,
    run_name: str,
    processes: int | None,
) -> str:
    """Describe the number of runs and their approximate time in minutes. Raises InputError.

    Args:
        names: names of the methods.
        scenarios: scenarios by name.
        runs: number of runs of each method on each scenario.
        run_name: name of a run: seed, candidate.
        processes: number of processes at once (None: one per processor).
    """
    run_count = len(names) * len(scenarios) * runs
    at_once = process_count(len(names) * len(scenarios), processes)
    work = sum(HEAVY.get(name, USUAL) for name in names) * runs
    minutes = work * sum(map(_naive_run_time, build_settings(scenarios).values())) / at_once / 60
    return (
        f"{count_noun(len(names), 'method')} x {count_noun(len(scenarios), 'scenario')} x "
        f"{count_noun(runs, run_name)} = {count_noun(run_count, 'run')}; "
        f"{_rough_time_text(minutes)} on {at_once:,} process{'es' * (at_once != 1)}"
    )


def _naive_run_time(setting: Setting) -> float:
    """Measure the time of a run of the naive observer [s]."""
    began = time.perf_counter()
    run_trial(NAIVE, method_registry()[NAIVE], "", setting, [setting.scenario.simulation.seed])
    return time.perf_counter() - began


def _rough_time_text(minutes: float) -> str:
    """Return a time to one digit as text."""
    if minutes < 1:
        return "less than a minute"
    number, unit = (minutes, "min") if minutes < 90 else (minutes / 60, "h")
    return f"about {float(f'{number:.1g}'):g} {unit}"
