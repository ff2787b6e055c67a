"""Numbers behind the claims, of runs that are known in full."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from undeadzone_paper import Paper, measures, trials
from undeadzone_paper.example import D


def test_left_of_the_zone_the_printed_decomposition_is_off_by_two_widths(
    paper: Paper,
) -> None:
    """And with d_l = -D the printed bound of what the sensor takes off is not 0."""
    claims = trials._sensor_claims(paper.evidence)
    positive, negative = trials.SIGNS
    decomposition, widths = claims["decomposition"], claims["width-bound"]
    assert decomposition.printed[positive] == pytest.approx(2 * D)
    assert decomposition.printed[negative] == pytest.approx(0.0, abs=1e-12)
    assert decomposition.repaired == pytest.approx(0.0, abs=1e-12)
    assert widths.printed[positive] == pytest.approx(D)
    assert widths.printed[negative] == 0.0


def test_the_widths_of_a_run_that_diverges_are_off_without_bound() -> None:
    runs: list[Any] = [SimpleNamespace(divergence_time=time) for time in (None, 3.0)]
    assert measures.worst_value(lambda run: 0.25, runs[:1]) == 0.25
    assert measures.worst_value(lambda run: 0.25, runs) == np.inf
