"""Sensors with one edge: from a log to C that agrees with the graph."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import undeadzone as uz
from further import further
from records import write_log
from undeadzone.cli import group
from undeadzone.util.arrays import Floats

STEP, EDGE = 1.0, 1.84  # s, l/min: a flow meter reads 0 below


def flow(jump: bool) -> tuple[Floats, Floats]:
    """Return the opening of a valve and the readings of a meter with a low-flow cut-off."""
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(0, 60, 80), 25)
    x, z = 0.0, np.empty(u.size)
    for k, opening in enumerate(u):
        z[k] = x + 0.03 * rng.standard_normal()
        x += (0.12 * opening - x) / 6
    above = np.where(z > EDGE, z if jump else z - EDGE, 0.0)
    return u, np.round(above, 2)


def invoke(*words: str) -> str:
    result = CliRunner().invoke(group, list(words))
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.parametrize("jump", [True, *further(False)])
def test_a_sensor_without_a_left_edge_ends_in_code(jump: bool, tmp_path: Path) -> None:
    """Readings that are shifted need the option; those of a jump sensor show it by themselves."""
    u, y = flow(jump)
    log = tmp_path / "flow.csv"
    write_log(log, "t,u,y", STEP, u, y)
    options = () if jump else ("--left", "inf")
    words = ("--order", "1", "--delay", "0", "--no-figures", "--out", str(tmp_path))
    invoke("identify", str(log), *options, *words)
    numbers = json.loads((tmp_path / "identify.json").read_text())
    assert numbers["verdict"] == ("jump" if jump else "dead_zone")
    assert numbers["right"][1] < EDGE < numbers["right"][2]
    assert (numbers["left"], numbers["width"]) == (None, None)
    assert any("taken to have none" in one for one in numbers["remarks"])
    scenario = tmp_path / "flow.toml"
    assert "left = inf  # 95 %: no edge" in scenario.read_text()
    printed = invoke(
        "estimate", str(scenario), str(log), "--no-figures", "--out", str(tmp_path / "e")
    )
    low, high = map(float, re.findall(r"d_right .*\[([\d.]+), ([\d.]+)\]", printed)[0])
    assert low < EDGE < high
    for precision in ("double", "single"):
        out = str(tmp_path / precision)
        report = invoke("export", str(scenario), "--precision", precision, "--out", out)
        assert "REFUSED" not in report
        assert "left" not in (Path(out) / "flow.h").read_text()


def test_an_edge_that_does_not_exist_is_never_reached() -> None:
    """A reading beyond it is none, a mirrored sensor gives mirrored estimates, no z is far off."""
    u, y = flow(jump=False)
    plant = uz.Plant(A=[[-1 / 6]], B=[[0.02]], C=[[1.0]])
    runs = []
    for sign, beyond in ((1, np.nan), (1, -9.0), (-1, 9.0)):
        right, left = (EDGE, np.inf)[::sign]
        sensor = uz.Sensor(right=right, left=left, noise_before=0.03)
        online = uz.Online(uz.Auto(right=[1.0, 3.0]), plant, sensor, STEP)
        seen = sign * y[:400]
        seen[200:203] = beyond
        estimates = [online.update(*sample) for sample in zip(seen, sign * u, strict=False)]
        runs.append(sign * np.array([one.z[0] for one in estimates]))
        assert {one.right[0] + one.left[0] for one in estimates} == {np.inf}
        assert estimates[-1].refused[0] == (3 if np.isfinite(beyond) else 0)
    assert np.array_equal(runs[0], runs[1])
    assert runs[2] == pytest.approx(runs[0], rel=1e-9)
    outside = y[:400] > 0
    outside[[*range(50), 200, 201, 202]] = False
    assert np.std((runs[0] - y[:400] - EDGE)[outside]) < 0.05
    with pytest.raises(uz.InputError, match="'certified' needs two edges"):
        uz.Online(uz.Certified(), plant, sensor, STEP)
