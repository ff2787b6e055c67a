"""Exports on bad readings: float flags what double flags, and both show the side of `Online`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import undeadzone as uz
from test_engines import OBSERVERS, small
from undeadzone.compile.replica import replica
from undeadzone.exports import accuracy, parts, vectors
from undeadzone.exports.code import Code, code
from undeadzone.exports.parts import Step
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import Floats

FILTERS = ("kalman", "extended", "censored")
FLAGS = ("consistent", "refused", "restarts", "side")


def along(printed: Code, rows: Floats) -> Floats:
    """What an export gives along inputs, computed without a compiler."""
    evaluate, kind = replica(printed.results), printed.kind
    state, params = printed.step.start.astype(kind), printed.step.defaults.astype(kind)
    outputs = []
    with np.errstate(all="ignore"):
        for row in rows.astype(kind):
            state, out = evaluate(vectors._entries(state, row, params))
            outputs.append(out)
    return np.array(outputs, float)


def broken(step: Step, scenario: Scenario) -> Floats:
    """A run with readings beyond both ends, none for a while, and at last a wire that broke."""
    rows = vectors.recorded(resolve_scenario(scenario), step)
    rows = np.vstack([rows, np.repeat(rows[-1:], 400, axis=0)])
    rows[40:45, 0] = np.nan
    rows[[60, 70, 80, 90, 91], 0] = 7.0, -3.0, np.inf, 1.2, -0.8
    rows[150:, 0] = 5.0
    return rows


@pytest.mark.parametrize("method", FILTERS)
def test_float_refuses_what_double_refuses(method: str) -> None:
    sensor = {"right": 0.5, "left": 0.3, "noise": 0.01, "range": [-0.8, 1.2]}
    observer = {"method": method} | OBSERVERS[method][1]
    scenario = small("sampled", sensor=sensor, observer=observer)
    step = parts.build(resolve_scenario(scenario))
    rows, places = broken(step, scenario), accuracy.places_of(step.outputs)
    single, double = (along(code(step, kind), rows) for kind in (True, False))
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
def test_the_side_of_an_export_is_that_of_online(sensor: dict[str, Any]) -> None:
    """Along a random stream, missing readings among it."""
    observer = {"method": "kalman", "right": [0.05, 1.0]}
    scenario = small("sampled", sensor=sensor, observer=observer)
    step = parts.build(resolve_scenario(scenario))
    random = np.random.default_rng(7)
    rows = 0.1 * np.cumsum(random.standard_normal((500, 2)), axis=0)
    rows[random.random(500) < 0.05, 0] = np.nan
    shown = along(code(step, False), rows)[:, accuracy.places_of(step.outputs)["side"]]
    online = uz.Online(scenario.observer, scenario.plant, scenario.sensor, scenario.simulation.step)
    _, sides = online.update_many(rows[:, :1], rows[:, 1:])
    np.testing.assert_array_equal(shown, sides)
    assert len(np.unique(sides)) > 2
