"""How much work a contest is: told before it starts."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Final

from undeadzone.scenario.schema import Scenario
from undeadzone_arena.contest.leaderboard import NAIVE
from undeadzone_arena.contest.methods import catalogue
from undeadzone_arena.contest.prior_knowledge import Setting, situations
from undeadzone_arena.contest.trials import processes_for, trial

# Times a run of the naive observer: `python -m benchmarks arena_effort`.
HEAVY: Final[Mapping[str, float]] = {
    "moving_horizon": 68.0,
    "particle_filter": 65.0,
    "censored": 24.0,
    "auto": 23.0,
    "printed": 7.0,
    "printed_fed": 7.0,
}
USUAL: Final = 2.0  # of all others


def in_words(
    names: Sequence[str],
    grounds: Mapping[str, Scenario],
    runs: int,
    what: str,
    processes: int | None,
) -> str:
    """How many runs there are, and about how many minutes they take. Raises InputError.

    Args:
        names: of the methods.
        grounds: scenarios by name.
        runs: of each method on each scenario.
        what: what a run is for: seeds, candidates.
        processes: at once; None: one per processor.
    """
    total = len(names) * len(grounds) * runs
    at_once = processes_for(len(names) * len(grounds), processes)
    work = sum(HEAVY.get(name, USUAL) for name in names) * runs
    minutes = work * sum(map(_naive, situations(grounds).values())) / at_once / 60
    return (
        f"{_count_runs(len(names), 'method')} x {_count_runs(len(grounds), 'scenario')} x "
        f"{_count_runs(runs, what)} = {_count_runs(total, 'run')}; {_about(minutes)} on "
        f"{_count_runs(at_once, 'process', 'processes')}"
    )


def _naive(setting: Setting) -> float:
    """Return the time that a run of the naive observer takes [s]."""
    began = time.perf_counter()
    trial(NAIVE, catalogue()[NAIVE], "", setting, [setting.scenario.simulation.seed])
    return time.perf_counter() - began


def _about(minutes: float) -> str:
    """Return a time to one digit."""
    if minutes < 1:
        return "less than a minute"
    number, unit = (minutes, "min") if minutes < 90 else (minutes / 60, "h")
    return f"about {float(f'{number:.1g}'):g} {unit}"


def _count_runs(number: int, one: str, many: str = "") -> str:
    """Return 1 run, 2 runs."""
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"
