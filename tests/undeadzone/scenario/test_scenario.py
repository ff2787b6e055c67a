"""Scenarios: files that run as they are, every wrong input with its own error and key.

And a fuzz that lets nothing else out.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from scenes import PAPER, scene, table, tables_of
from undeadzone.errors import (
    FileError,
    InputError,
)
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import parse, read
from undeadzone.simulation.simulate import simulate
from undeadzone.util.toml import to_tables

SAMPLED = """
# What runs on hardware: 100 Hz sampling, asymmetric widths, sensor noise, an inexact model.
title = "Sampled, asymmetric, noisy, mismatched"

[plant]
A = [[0.0, 1.0], [-1.1, -1.8]]
B = [[0.0], [0.9]]
C = [[1.0, 0.0]]
x0 = [1.0, 0.0]

[model]                       # what observer and controller believe; absent keys are the plant's
A = [[0.0, 1.0], [-1.0, -2.0]]
B = [[0.0], [1.0]]

[sensor]
kind = "deadzone"
right = 1.3
left = 0.6
noise = 0.02

[reference]
kind = "sine"
amplitude = 5
frequency = 1

[disturbance]                 # at the plant input
kind = "sine"
amplitude = 10.0
frequency = 0.3

[observer]
method = "certified"
L = [1.0, 1.5]
gamma = 10.0
widths0 = [0.0, 0.0]
width_max = 3.0

[controller]
method = "state_feedback"
poles = [-10.0, -10.0]

[simulation]
duration = 20.0
time = "sampled"
step = 1e-2
seed = 1
"""
PENDULUM: dict[str, Any] = tables_of("""
f = ["rate", "-g * sin(angle) - b * rate + torque"]
h = ["angle"]
states = ["angle", "rate"]
inputs = ["torque"]
parameters = { g = 9.81, b = 0.8 }
x0 = [0.1, 0.0]
x_eq = [0.0, 0.0]
""")


# --- files that run ---


def test_the_papers_scenario_reads_and_runs(tmp_path: Path) -> None:
    (tmp_path / "paper.toml").write_text(PAPER)
    scenario = read(tmp_path / "paper.toml")
    assert scenario.title == "Paper example"
    assert np.asarray(scenario.plant.A).tolist() == [[0, 1], [-1, -2]]
    assert (scenario.sensor.kind, scenario.simulation.time, scenario.simulation.seed) == (
        "deadzone",
        "continuous",
        0,
    )
    run = simulate(scenario)
    assert run.t.size == 2001
    assert run.x[0].tolist() == [0.5, 0.0]


def test_the_sampled_scenario_reads_and_runs() -> None:
    run = simulate(parse(SAMPLED))
    assert run.info.widths == [1.3, 0.6]
    assert run.info.threshold[0] == pytest.approx(0.0778, abs=1e-4)
    assert run.t.size == 2001
    assert run.info.integration_error is None
    assert 0.1 < run.silent_fraction < 0.2
    assert abs(run.widths[0, 0] - 1.3) < 0.2


def test_a_model_that_differs_in_parameters_only() -> None:
    problem = resolve_scenario(scene(plant=PENDULUM, model={"parameters": {"b": 0.1}}))
    assert problem.plant.linear.A[1, 1] == -0.8
    assert problem.model.linear.A[1].tolist() == [-9.81, -0.1]


def test_paths_are_relative_to_the_folder_of_the_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "r.csv").write_text("t,r\n0,0\n1,2\n2,0\n")
    (tmp_path / "mine.toml").write_text(
        PAPER.replace(
            '{ kind = "sine", amplitude = 5.0, frequency = 1.0 }',
            '{ kind = "csv", path = "data/r.csv" }',
        )
    )
    monkeypatch.chdir("/")
    run = simulate(read(tmp_path / "mine.toml"))
    assert run.r[1000, 0] == pytest.approx(2)


@pytest.mark.parametrize("step", [1e-7, 1e-5])
def test_fast_sampling_is_no_obstacle(step: float) -> None:
    run = simulate(scene(simulation={"time": "sampled", "step": step, "duration": 100 * step}))
    assert run.info.certified


def test_fast_plants_in_their_own_unit_of_time_run_alike() -> None:
    """Poles at 1e4 rad/s, third order: no check takes it for unobservable or unable to follow."""
    a = np.array([1e12, 3e8, 3e4])
    run = simulate(
        scene(
            """
            reference = { kind = "sine", amplitude = 5.0, frequency = 1000.0 }
            observer = { method = "certified", gamma = 10000.0 }
            controller = { method = "state_feedback", poles = [-10000.0, -20000.0, -30000.0] }
            simulation = { duration = 0.02, step = 1e-6 }
            """,
            plant={"companion": a.tolist(), "x0": [0.5, 0.0, 0.0]},
        )
    )
    assert run.info.certified
    assert run.rms_tracking < 10
    assert run.fully_identifiable


# --- wrong inputs ---


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("plant = ", "not valid TOML: Invalid value"),
        ("[plant]\nA = 1\nA = 2\n", "not valid TOML: .*overwrite"),
        ("x = " + "9" * 5000, "not valid TOML"),
        ("x = " + "[" * 5000, "not valid TOML: nested too deeply"),
        (".".join("a" * 5000) + " = 1", "a dotted key of more than"),
        ("'' = 1", "'': unknown key"),
        ("'a.b`c' = 1", "unknown key"),
        ("[plant]\n'\\n' = 1", "unknown key"),
        ("", "plant: missing"),
        ("plant = 2020-01-01", "plant: "),
        ("plant = { A = 2020-01-01 }", "plant.A: expected numbers"),
    ],
)
def test_wrong_text(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse(text)


def test_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00\x01")
    for path, words in [
        ("missing.toml", "No such file"),
        (".", "directory"),
        ("binary.toml", "not UTF-8 text"),
        ("nul\0.toml", "null"),
    ]:
        with pytest.raises(FileError, match=f"cannot read: .*{words}"):
            read(tmp_path / path)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("", "holds no samples"),
        ("0,1\n1,2,3\n", "sample 2 has 3 columns, expected 2"),
        ("0,1\n1,x\n", "sample 2 is not all finite"),
    ],
)
def test_wrong_csv_in_a_scenario(tmp_path: Path, rows: str, words: str) -> None:
    (tmp_path / "bad.csv").write_text(rows)
    for key in ("reference", "disturbance"):
        with pytest.raises(FileError, match=f"{key}.path: .*bad.csv.*{words}"):
            resolve_scenario(scene(**{key: {"kind": "csv", "path": str(tmp_path / "bad.csv")}}))


OBSERVED = """
[observer]
method = "extended"
right = [0.0, 2.0]
noise = 0.02
"""


def with_compare(compare: str, observed: str = OBSERVED) -> str:
    """A scenario with an observer and a [compare] table."""
    plain = tomli_w.dumps({key: value for key, value in table().items() if key != "observer"})
    return f"{plain}\n{observed}\n[compare]\n{compare}\n"


def test_a_rival_may_be_like_the_observer() -> None:
    scenario = parse(with_compare('like = "observer"\nblind = true'))
    own = to_tables(scenario.observer)
    assert own["noise"] == 0.02
    assert scenario.compare is not None
    assert to_tables(scenario.compare) == own | {"blind": True}
    assert str(parse(str(scenario))) == str(scenario)
    other = scenario | {"observer": {"noise": 0.5}, "compare": {"like": "observer", "x_std": 0.1}}
    assert other.compare is not None
    assert to_tables(other.compare) == own | {"noise": 0.5, "x_std": 0.1}


@pytest.mark.parametrize(
    ("compare", "observed", "expected"),
    [
        ('like = "controller"', OBSERVED, 'compare.like: expected "observer"'),
        ('like = "observer"\nmethod = "kalman"', OBSERVED, "Leave out like, or compare.method"),
        ('like = "observer"\nblind = true', "", "no [observer]"),
        ('like = "observer"\nblnd = true', OBSERVED, "compare.blnd"),
    ],
)
def test_a_rival_is_like_nothing_else(compare: str, observed: str, expected: str) -> None:
    with pytest.raises(InputError, match=re.escape(expected)):
        parse(with_compare(compare, observed))
