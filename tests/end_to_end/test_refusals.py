"""What a scenario is refused for: `refusals.toml` has the changes, the error and its words."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from _pytest.mark.structures import ParameterSet

import undeadzone as uz
from scenes import scene
from undeadzone.errors import InputError
from undeadzone.scenario.schema import Scenario
from undeadzone_design.synthesis.design import design
from undeadzone_export.page.build import build_live_page

READERS: dict[str, Callable[[Scenario], Any]] = {
    "simulate": uz.simulate,
    "run_ensemble": uz.run_ensemble,
    "design": design,
    "page": build_live_page,
    "tune": lambda scenario: uz.tune(scenario, scenario.tune),
}


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with changes; one that names a method or a kind takes the place of the former."""
    result = dict(table)
    for key, value in changes.items():
        part = isinstance(value, dict) and {"method", "kind"}.isdisjoint(value)
        result[key] = merged(result.get(key, {}), value) if part else value
    return result


def refusals() -> Iterator[ParameterSet]:
    """Each row of the table with what its section says of all."""
    text = Path(__file__).with_name("refusals.toml").read_text(encoding="utf-8")
    for name, section in tomllib.loads(text).items():
        start = tomllib.loads(section.get("scenario", ""))
        for changes, error, words in section["rows"]:
            tables = merged(start, tomllib.loads(changes))
            reader = READERS[section.get("by", "simulate")]
            yield pytest.param(reader, tables, error, words, id=f"{name}: {words[:50]}")


@pytest.mark.parametrize(("reader", "tables", "error", "words"), list(refusals()))
def test_a_scenario_is_refused_by_the_name_of_its_mistake(
    reader: Callable[[Scenario], Any], tables: dict[str, Any], error: str, words: str
) -> None:
    with pytest.raises(InputError) as refusal:
        reader(scene(**tables))
    message = str(refusal.value)
    assert type(refusal.value).__name__ == error
    assert re.search(words, message)
    assert len(message) < 510
    assert "\n" not in message


@pytest.mark.parametrize(
    ("part", "key"),
    [
        ({"plant": uz.Plant(A=np.nan, B=1, C=1)}, "plant.A"),
        ({"sensor": uz.Sensor(right=np.nan, left=1.0)}, "sensor.right"),
        ({"reference": uz.Step(amplitude=1.0, time=np.inf)}, "reference.time"),
        ({"observer": uz.Certified(L=[np.inf])}, "observer.L"),
        ({"observer": uz.Luenberger(poles=[np.nan])}, "observer.poles"),
        ({"controller": uz.StateFeedback(alpha=1.0, Q=np.inf)}, "controller.Q"),
        ({"controller": uz.StateFeedback(K=1, robust=uz.Robust(gain=np.nan))}, "robust.gain"),
    ],
)
def test_numbers_of_a_program_are_finite(part: dict[str, Any], key: str) -> None:
    signal = uz.Sine(amplitude=1.0, frequency=1.0)
    parts = {"plant": uz.Plant(A=-1, B=1, C=1), "sensor": uz.Sensor(right=1.0, left=1.0)}
    with pytest.raises(InputError, match=f"{key}.* must be finite"):
        uz.simulate(uz.Scenario(**{"reference": signal} | parts | part))
