"""Sensors with one edge: from a log to C that agrees with the graph."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from further import further
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
    table = np.column_stack([STEP * np.arange(u.size), u, y])
    np.savetxt(log, table, delimiter=",", header="t,u,y", comments="")
    options = () if jump else ("--left", "inf")
    words = ("--order", "1", "--delay", "0", "--no-figures", "--out", str(tmp_path))
    invoke("identify", str(log), *options, *words)
    numbers = json.loads((tmp_path / "identify.json").read_text())
    assert numbers["verdict"] == ("jump" if jump else "dead_zone")
    assert numbers["right"][1] < EDGE < numbers["right"][2]
    assert (numbers["left"], numbers["width"]) == (None, None)
    assert any("taken to have none" in one for one in numbers["remarks"])
    scenario = tmp_path / "flow.toml"
    assert "so far away that no reading lies beyond it" in scenario.read_text()
    printed = invoke(
        "estimate", str(scenario), str(log), "--no-figures", "--out", str(tmp_path / "e")
    )
    low, high = map(float, re.findall(r"d_right .*\[([\d.]+), ([\d.]+)\]", printed)[0])
    assert low < EDGE < high
    for precision in ("double", "single"):
        out = str(tmp_path / precision)
        report = invoke("export", str(scenario), "--precision", precision, "--out", out)
        assert "REFUSED" not in report
