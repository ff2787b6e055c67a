"""Exports on bad readings: float flags what double flags, and both show the side of `Online`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.firmware.bad_readings import day, scenario
from test_engines import OBSERVERS, small

import undeadzone as uz
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_export import accuracy, exported_step, selftest_vectors
from undeadzone_export.code import build_code
from undeadzone_export.exported_step import ExportedStep

FILTERS = ("kalman", "extended", "censored")
FLAGS = ("consistent", "refused", "restarts", "side")


def broken(step: ExportedStep, scenario: Scenario) -> Floats:
    """A run with readings beyond both ends, none for a while, and at last a wire that broke."""
    rows = selftest_vectors.record_inputs(resolve_scenario(scenario), step)
    rows = np.vstack([rows, np.repeat(rows[-1:], 400, axis=0)])
    rows[40:45, 0] = np.nan
    rows[[60, 70, 80, 90, 91], 0] = 7.0, -3.0, np.inf, 1.2, -0.8
    rows[150:, 0] = 5.0
    return rows


@pytest.mark.parametrize("method", FILTERS)
def test_float_refuses_what_double_refuses(method: str, tmp_path: Path) -> None:
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "range": [-0.8, 1.2]}
    observer = {"method": method} | OBSERVERS[method][1]
    scenario = small("sampled", sensor=sensor, observer=observer)
    step = exported_step.build_step(resolve_scenario(scenario))
    rows, places = broken(step, scenario), accuracy.field_slices(step.outputs)
    single, double = (
        accuracy.CompiledStep(build_code(step, kind), tmp_path)(rows) for kind in (True, False)
    )
    for flag in FLAGS:
        np.testing.assert_array_equal(single[:, places[flag]], double[:, places[flag]], flag)
    assert double[-1, places["refused"]] > 10
    assert double[-1, places["consistent"]] == 0
    for name in ("right_std", "left_std"):
        np.testing.assert_allclose(single[:, places[name]], double[:, places[name]], rtol=1e-3)


PLAYS: list[dict[str, Any]] = [
    {"kind": "play", "right": 0.2, "left": 0.2},
    {"kind": "play", "right": 0.2, "left": 0.1, "noise": 0.01},
    {"right": 0.5, "left": 0.3, "play": [0.1, 0.1]},
    {"right": 0.5, "left": 0.3, "range": [-0.8, 1.2]},
]


@pytest.mark.parametrize("sensor", PLAYS)
def test_the_side_of_an_export_is_that_of_online(sensor: dict[str, Any], tmp_path: Path) -> None:
    """Along a random stream, missing readings among it."""
    observer = {"method": "kalman", "right": [0.05, 1.0]}
    scenario = small("sampled", sensor=sensor, observer=observer)
    step = exported_step.build_step(resolve_scenario(scenario))
    random = np.random.default_rng(7)
    rows = 0.1 * np.cumsum(random.standard_normal((500, 2)), axis=0)
    rows[random.random(500) < 0.05, 0] = np.nan
    exported = accuracy.CompiledStep(build_code(step, False), tmp_path)(rows)
    exported = exported[:, accuracy.field_slices(step.outputs)["side"]]
    online = uz.Online(scenario.observer, scenario.plant, scenario.sensor, scenario.simulation.step)
    _, sides = online.update_many(rows[:, :1], rows[:, 1:])
    np.testing.assert_array_equal(exported, sides)
    assert len(np.unique(sides)) > 2


DAYS = [
    ("certified", "range"), ("kalman", "range"), ("kalman", "play"), ("extended", "jump"),
    ("censored", "play"),
]  # fmt: skip


@pytest.mark.parametrize(("method", "sensor"), DAYS)
def test_the_worst_day(method: str, sensor: str) -> None:
    """C in double follows `Online`, and float flags what double flags.

    10,000 samples with missing, wrong, stuck and impossible readings; `python -m benchmarks
    bad_readings` prints all of them.
    """
    found = day(scenario(method, sensor))
    assert not any(found.differing.values()), found.differing
    assert found.beside < 1e-10
    assert found.rounded < 1e-2
    assert (found.refused > 10) == (method != "certified")
