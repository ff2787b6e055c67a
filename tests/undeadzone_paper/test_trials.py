"""Numbers behind the claims, of runs that are known in full."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from undeadzone_paper import trials
from undeadzone_paper.example import D


def test_left_of_the_zone_the_printed_decomposition_is_off_by_two_widths(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And with d_l = -D the printed bound of what the sensor takes off is not 0."""
    monkeypatch.setattr(trials, "_worst_value", lambda measure, runs: 0.0)
    printed = dict.fromkeys((trials.RESTING, trials.BEGUN), ())
    evidence: Any = SimpleNamespace(printed=printed, repaired=())
    claims = trials._sensor_claims(evidence)
    decomposition, widths = claims["decomposition"], claims["width-bound"]
    assert decomposition.printed[trials.POSITIVE] == pytest.approx(2 * D)
    assert decomposition.printed[trials.NEGATIVE] == pytest.approx(0.0, abs=1e-12)
    assert decomposition.repaired == pytest.approx(0.0, abs=1e-12)
    assert widths.printed[trials.POSITIVE] == pytest.approx(D)
    assert widths.printed[trials.NEGATIVE] == 0.0


def test_the_widths_of_a_run_that_diverges_are_off_without_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(trials.m, "width_error", lambda run: 0.25)
    runs: list[Any] = [SimpleNamespace(divergence_time=time) for time in (None, 3.0)]
    assert [trials._lopsided_error(run) for run in runs] == [0.25, np.inf]
