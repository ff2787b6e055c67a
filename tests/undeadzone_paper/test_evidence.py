"""Which runs stand behind the claims."""

from __future__ import annotations

from typing import Any

from undeadzone.scenario.schema import Scenario
from undeadzone_paper import evidence
from undeadzone_paper.example import example_as_printed


def test_wrong_widths_never_move_along_the_reference_of_the_paper() -> None:
    """With a tanh term and without one; the widths never move."""
    calls: list[tuple[Scenario, dict[str, Any]]] = []

    class Recorder:
        def simulate_changed(self, scenario: Scenario, **changes: Any) -> None:
            calls.append((scenario, changes))

    runner: Any = Recorder()
    evidence._constant_width_runs(runner)
    assert [scenario.reference for scenario, _ in calls] == [example_as_printed(5.0).reference] * 2
    assert [changes["observer"].widths0 for _, changes in calls] == [[0.8, 0.8]] * 2
    assert all(changes["observer"].gamma < 1e-6 for _, changes in calls)
    plain, robust = (changes.get("controller") for _, changes in calls)
    assert plain is None
    assert robust.robust.gain == 5.0
