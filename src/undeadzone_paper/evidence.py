"""Runs for the verdicts on the paper's claims, as `runs.toml` lists them.

They are the example as printed, repaired, both off their nominal conditions, and with the paper's
further recommendations: a tanh term, a filter, identification.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeAlias

from undeadzone.results.run import Run
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.pipeline import identify
from undeadzone_paper.arm import HALF_GAP, ArmRuns, run_arm
from undeadzone_paper.equations import read_words
from undeadzone_paper.example import (
    AMPLITUDES,
    STARTED,
    D,
    example_as_printed,
    example_as_repaired,
)
from undeadzone_paper.measures import with_printed_V
from undeadzone_paper.printed import Outcome
from undeadzone_paper.theorem import (
    AS_PRINTED,
    ESTIMATED,
    GIVEN,
    READINGS_OF_THEOREM,
    TheoremVariant,
    example_of_theorem,
    run_theorem,
)

Runs: TypeAlias = tuple[Run, ...]

TABLES: Final = read_words("runs.toml")
CONDITIONS: Final[dict[str, Any]] = TABLES["words"] | {
    "half": HALF_GAP,
    "readings": READINGS_OF_THEOREM,
}
"""What the runs are made with, by the names that `claims.toml` uses."""

NOMINAL: Final = "nominal"
RESTING: Final = "from rest"
BEGUN: Final = f"from x1 = {STARTED:g}"


class Evidence(NamedTuple):
    """Runs by the rows of `runs.toml`. V of runs as printed is (30).

    Attributes:
        printed: as printed, by row and case
        repaired: as repaired, by row
        identified: the widths that `identify` finds in the log of a repaired run at 100 Hz, with
            noise on y and a wrong input gain of the model
        theorem: the outcomes of every reading of Theorem 4.1
        law: the run of Theorem 4.1 from x1 = 5, d - d^ given, and estimated
        arm: errors of a one-link arm behind gears
    """

    printed: dict[str, dict[str, Runs]]
    repaired: dict[str, Runs]
    identified: tuple[Interval, Interval]
    theorem: list[Outcome]
    law: Runs
    arm: ArmRuns


def gather_evidence(progress: Callable[[int], None] | None) -> Evidence:
    """Run all rows. Only nominal runs from rest are repeated with half the step.

    Args:
        progress: called with the number of steps just done
    """

    @functools.cache
    def run(build: Callable[[float], Scenario], *names: str) -> Run:
        """Run a version of the example under conditions."""
        changes = [TABLES["conditions"][name] for name in names]
        amplitude = AMPLITUDES["2 sin" in names]  # of the title
        scenario = functools.reduce(operator.or_, changes, build(amplitude))
        twice = {*names} <= {"2 sin"}
        found = simulate(scenario, check_step=twice, progress=progress)
        return with_printed_V(found) if build is example_as_printed else found

    def run_all(build: Callable[[float], Scenario], row: list[list[str]]) -> Runs:
        """Run a row of a version of the example."""
        return tuple(run(build, *names) for names in row)

    printed = {
        name: {case: run_all(example_as_printed, row) for case, row in cases.items()}
        for name, cases in TABLES["printed"].items()
    }
    repaired = {name: run_all(example_as_repaired, row) for name, row in TABLES["repaired"].items()}
    return Evidence(
        printed,
        repaired,
        identified=_identify_widths(*repaired["logged"]),
        theorem=run_theorem(progress),
        law=_law_runs(progress),
        arm=run_arm(),
    )


def _law_runs(progress: Callable[[int], None] | None) -> Runs:
    """Run Theorem 4.1 from x1 = 5 with d - d^ given, and with it estimated."""
    scenarios = [
        example_of_theorem(
            TheoremVariant(mismatch, AS_PRINTED, "(39)", "printed", False, -1.0, STARTED, D)
        )
        | {"simulation": {"step": 1e-3}}
        for mismatch in (GIVEN, ESTIMATED)
    ]
    return tuple(
        with_printed_V(simulate(scenario, check_step=False, progress=progress))
        for scenario in scenarios
    )


def _identify_widths(run: Run) -> tuple[Interval, Interval]:
    """Identify d_r and d_l from u and y of a run, with 95 % intervals [z]."""
    found: Any = identify(t=run.info.step, u=run.u, y=run.y, order=2, place="sensor")
    return found.right, found.left
