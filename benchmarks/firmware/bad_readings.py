"""Exports on the worst day: C in double and in float against `Online`, along a spoilt record."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import undeadzone as uz
from benchmarks.markdown import head, row
from undeadzone.errors import InputError
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats
from undeadzone_export import exported_step, selftest_vectors
from undeadzone_export.accuracy import CompiledStep
from undeadzone_export.code import build_code
from undeadzone_export.exported_step import field_slices

SAMPLES = 10_000
FLAGS = ("side", "consistent", "refused", "restarts")
NUMBERS = ("right", "left", "right_std", "left_std")
OBSERVERS: dict[str, Any] = {
    "certified": uz.Certified(L=[1.0, 1.5], gamma=10.0, widths0=[0.1, 0.1], width_max=3.0),
    "kalman": uz.Kalman(right=[0.1, 1.0]),
    "extended": uz.Extended(right=[0.1, 1.0]),
    "censored": uz.Censored(right=[0.1, 1.0]),
}
SENSORS: dict[str, dict[str, Any]] = {
    "dead zone": {"right": 0.5, "left": 0.3},
    "range": {"right": 0.5, "left": 0.3, "range": [-0.8, 1.2]},
    "jump": {"kind": "jump", "right": 0.5, "left": 0.3},
    "play": {"kind": "play", "right": 0.2, "left": 0.1},
    "play and zone": {"right": 0.5, "left": 0.3, "play": [0.1, 0.1]},
}


class Day(NamedTuple):
    """What an export does on a worst day.

    Attributes:
        differing: samples at which a flag of float is not that of double, by its name.
        beside: largest relative difference of C in double to `Online`, over flags and widths.
        rounded: largest relative difference of float to double, over widths and deviations.
        refused: readings that were taken for wrong.
    """

    differing: dict[str, int]
    beside: float
    rounded: float
    refused: int


def scenario(method: str, sensor: str) -> Scenario:
    """A loop of second order with one of the observers behind one of the sensors."""
    return uz.Scenario(
        plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]]),
        sensor=uz.Sensor(noise=0.01, **SENSORS[sensor]),
        reference=uz.Sine(amplitude=1.5, frequency=0.5),
        observer=OBSERVERS[method],
        simulation=uz.Simulation(time="sampled", step=0.01, duration=1.0),
    )


def spoilt(rows: Floats, seed: int = 0) -> Floats:
    """A record with all that goes wrong with readings, which stand in its first column.

    3 % are missing, 0.5 % are 20 times too large, 0.1 % infinite, 0.3 % beyond the range; of each
    thousand 40 in a row are missing and 30 in a row stuck.
    """
    random = np.random.default_rng(seed)
    rows = rows.copy()
    y, share = rows[:, 0], random.random(len(rows))
    size = np.abs(y).max()
    sign = random.choice([-1.0, 1.0], len(rows))
    bad = (share < 0.03, share < 0.035, share < 0.036, share < 0.039)
    y[:] = np.select(bad, [np.nan, 20 * size * sign, np.inf, 2.5 * size * sign], y)
    for start in range(500, len(y), 1000):
        y[start : start + 40] = np.nan
        y[start + 300 : start + 330] = y[start + 300]
    return rows


def day(one: Scenario, samples: int = SAMPLES) -> Day:
    """What the exports of a scenario's observer do on a worst day."""
    problem = selftest_vectors.continue_scenario(one, samples)
    step = exported_step.build_step(problem)
    rows = spoilt(selftest_vectors.record_inputs(problem, step))
    with tempfile.TemporaryDirectory() as folder:
        double, single = (
            CompiledStep(build_code(step, kind), Path(folder))(rows) for kind in (False, True)
        )
    online = uz.Online(one.observer, one.plant, one.sensor, one.simulation.step)
    estimate, side = online.update_many(rows[:, :1], rows[:, 1:])
    live = estimate._asdict() | {"side": side}
    places = field_slices(step.outputs)
    flags = [name for name in FLAGS if name in places]
    numbers = [name for name in NUMBERS if name in places]
    return Day(
        {name: _differing(single[:, places[name]], double[:, places[name]]) for name in flags},
        max(_gap(double[:, places[name]], live[name]) for name in (*flags, *numbers)),
        max(_gap(single[:, places[name]], double[:, places[name]]) for name in numbers),
        int(double[-1, places["refused"]].sum()) if "refused" in places else 0,
    )


def _differing(one: Floats, other: Floats) -> int:
    """At how many samples two signals differ."""
    return int((one != other).any(axis=1).sum())


def _gap(one: Floats, other: Floats) -> float:
    """The largest difference, relative to the second one at that sample."""
    return float(np.max(np.abs(one - other) / np.maximum(np.abs(other), 1e-9)))


def table() -> str:
    """Every observer behind every sensor that it takes."""
    lines = [
        "## Exports on the worst day",
        "",
        f"{SAMPLES} samples: 3 % missing, 0.5 % of 20 times the size, 0.1 % infinite, 0.3 % beyond "
        "the range; of each thousand 40 in a row missing, 30 in a row stuck.",
        "",
        *head("observer", "sensor", "refused", "flags of float that differ", "double beside Online",
              "float beside double"),
        *_rows(),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _rows() -> Iterator[str]:
    """A row for each observer and sensor."""
    for method in OBSERVERS:
        for sensor in SENSORS:
            try:
                found = day(scenario(method, sensor))
            except InputError:
                continue  # this observer does not take such readings
            differing = str(sum(found.differing.values()))
            gaps = f"{found.beside:.1g}", f"{found.rounded:.1g}"
            yield row(method, sensor, str(found.refused), differing, *gaps)
