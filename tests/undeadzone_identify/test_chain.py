"""From an answer to code that compensates."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from undeadzone_export.snippet import Lost
from undeadzone_identify.chain import run_snippet_chain


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_an_axis_is_off_by_its_gap_and_with_the_code_hardly(tmp_path: Path) -> None:
    """The command goes to and fro ten times the gap."""
    gap = (0.2, 0.19, 0.21)
    lost = Lost("backlash", gap, gap, gap, "mm", "log.csv", is_ahead=True)
    signal = np.sin(np.arange(2000) * 0.01)
    found = run_snippet_chain(lost, signal, tmp_path)
    assert found.numbers["axis_off"] == pytest.approx(0.2, rel=0.01)
    assert found.numbers["axis_off_with_code"] < 0.02
    assert "up to 0.2 mm of an axis simulated with this gap" in found.words["axis off"]
