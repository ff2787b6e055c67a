"""What a run of each method of the arena costs, set-up and all, in runs of the naive observer."""

from __future__ import annotations

import time

from undeadzone_arena.contest.effort import HEAVY, USUAL
from undeadzone_arena.contest.entry import read_knob_numbers
from undeadzone_arena.contest.leaderboard import NAIVE
from undeadzone_arena.contest.methods import NOTHING, method_registry
from undeadzone_arena.contest.prior_knowledge import build_setting
from undeadzone_arena.contest.scenario_sets import arena_scenarios
from undeadzone_arena.contest.trials import run_trial

SCENARIO = "nominal"


def table() -> str:
    """Measured processor time, and what `arena` reckons with before it starts."""
    setting, knobs = build_setting(arena_scenarios("held_out")[SCENARIO]), read_knob_numbers(None)

    def seconds(name: str) -> float:
        began = time.process_time()
        run_trial(name, method_registry()[name], SCENARIO, setting, [0], knobs.get(name, NOTHING))
        return time.process_time() - began

    seconds(NAIVE)  # what is loaded at the first run
    naive = min(seconds(NAIVE) for _ in range(3))
    lines = ["## Effort of the arena", "", f"Scenario `{SCENARIO}`, in runs of `{NAIVE}`.", ""]
    lines += ["| method | measured | reckoned with |", "|---|---|---|"]
    for name in method_registry():
        reckoned = HEAVY.get(name, USUAL)
        lines.append(f"| {name} | {seconds(name) / naive:.1f} | {reckoned:g} |")
    return "\n".join(lines) + "\n"
