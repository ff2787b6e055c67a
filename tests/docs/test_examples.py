"""Every example runs and shows what it is there to show."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest

import undeadzone as uz
from documents import EXAMPLES
from requirements import import_package

FOLDER = EXAMPLES
RUNS: dict[str, uz.Run] = {}
SHORTER = {"two_link": 6.0, "two_link_gears": 0.3, "ur5": 3.0, "elastic_joint": 8.0}  # [s]


def run(name: str) -> uz.Run:
    if name not in RUNS:
        scenario = uz.read(FOLDER / f"{name}.toml")
        if name in SHORTER:
            short = msgspec.structs.replace(scenario.simulation, duration=SHORTER[name])
            scenario = msgspec.structs.replace(scenario, simulation=short)
        if name == "ur5":
            import_package("adam")
        RUNS[name] = uz.simulate(scenario)
    return RUNS[name]


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.toml")))
def test_runs_to_the_end(name: str) -> None:
    result = run(name)
    assert result.divergence_time is None
    assert np.isfinite(result.rms_tracking)


@pytest.mark.parametrize("name", ["paper_5sin", "paper_2sin"])
def test_paper(name: str) -> None:
    result = run(name)
    assert result.rms_tracking < 1e-3
    np.testing.assert_allclose(result.widths, 1.0, atol=1e-3)
    assert result.V is not None
    assert result.info.integration_error is not None
    assert np.diff(result.V).max() <= result.info.integration_error
    assert result.info.integration_error < 1e-8


WIDTHS = {
    "asymmetric_noise": ([[1.3, 0.6]], 0.03),
    "jump_velocity": ([[0.5, 0.3]], 0.03),
    "third_order": ([[0.4, 0.8]], 0.1),
    "two_outputs": ([[0.5, 0.3], [0.2, 0.6]], 1e-6),
    "load_cell_limited": ([[1.2, 0.7]], 0.05),
    "two_link": ([[0.05, 0.03], [0.08, 0.06]], 0.0015),
    "elastic_joint": ([[0.05, 0.03]], 0.0015),
    "pendulum": ([[0.12, 0.05]], 1e-6),
}


@pytest.mark.parametrize("name", WIDTHS)
def test_widths_are_estimated(name: str) -> None:
    widths, tolerance = WIDTHS[name]
    np.testing.assert_allclose(run(name).widths, widths, atol=tolerance)


def test_load_cell_limited() -> None:
    assert 0.1 < np.mean(np.abs(run("load_cell_limited").side) == 1) < 0.15


def test_integrators_give_the_width_alone() -> None:
    result = run("integrators")
    verdict = result.info.identifiable[0]
    known = [verdict[name] for name in ("width", "centre", "right", "left")]
    assert known == [True, False, False, False]
    assert result.widths.sum() == pytest.approx(2.0, abs=1e-4)
    assert abs(result.widths[0, 0] - 1.2) > 0.1


def test_the_declared_centre_makes_a_geared_motor_identifiable() -> None:
    """Both commands end well; without the declared centre neither would."""
    result = run("motor_position")
    assert result.fully_identifiable
    assert result.rms_estimation < 5e-3
    np.testing.assert_allclose(result.widths, 0.12, atol=0.01)
    scenario = uz.read(FOLDER / "motor_position.toml")
    assert uz.check(scenario).affirmed
    vague = msgspec.structs.replace(scenario.observer, centre=None)
    alone = msgspec.structs.replace(scenario, observer=vague)
    assert not uz.check(alone).affirmed


@pytest.mark.parametrize(
    ("name", "signal", "limit"),
    [
        ("two_link", "rms_tip", 2e-3),
        ("ur5", "rms_tip", 0.03),
        ("elastic_joint", "rms_tip", 1e-3),
        ("pendulum", "rms_tracking", 1e-6),
        ("load_cell_limited", "rms_tracking", 0.06),
    ],
)
def test_the_output_is_on_its_path(name: str, signal: str, limit: float) -> None:
    assert getattr(run(name), signal) < limit


def test_ur5() -> None:
    result = run("ur5")
    np.testing.assert_allclose(result.widths[[0, 1, 3]].sum(axis=1), [0.08, 0.14, 0.1], rtol=0.05)


def test_ten_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = runpy.run_path(str(FOLDER / "your_plant.py"))
    assert (np.abs(found["run"].d_hat[-1] - [1.0, 0.7]) < 1.96 * found["run"].d_std[-1]).all()
    assert found["run"].rms_estimation < 0.05
    assert (tmp_path / "your_plant.png").stat().st_size > 10_000


def test_every_alternative_of_the_template_is_toml() -> None:
    """A line after # that assigns or opens a table may be taken as it is."""
    template = (FOLDER.parent / "src/undeadzone/template.toml").read_text(encoding="utf-8")
    lines = re.findall(r"^# ((?:\[[\w.]+\]|[\w.\"\[\],]+ = ).*)$", template, re.M)
    assert len(lines) > 25
    for line in lines:
        tomllib.loads(line)
