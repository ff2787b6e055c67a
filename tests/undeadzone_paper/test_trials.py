"""Runs and numbers behind the claims."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from undeadzone_paper import Paper, measures, trials
from undeadzone_paper.evidence import CONDITIONS, TABLES
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


def test_wrong_widths_never_move_along_the_reference_of_the_paper(paper: Paper) -> None:
    """With a tanh term and without one."""
    for run in paper.evidence.repaired["tanh"]:
        np.testing.assert_allclose(run.d_hat, 1.0 - CONDITIONS["mismatched"], atol=1e-6)
        np.testing.assert_allclose(run.r[:, 0], 5.0 * np.sin(2 * np.pi * run.t), atol=1e-9)


def test_the_words_of_the_conditions_have_their_numbers() -> None:
    words, conditions = TABLES["words"], TABLES["conditions"]
    far = TABLES["repaired"]["far"]
    starts = [conditions[names[-1]]["plant"]["x0"] for names in far]
    assert words["noise"] == conditions["noise"]["sensor"]["noise"]
    assert words["disturbance"] == conditions["gust"]["disturbance"]["amplitude"]
    assert words["slope"] == conditions["scaled"]["sensor"]["slope"]
    assert [words["starts"], words["farthest"]] == [len(far), np.abs(starts).max()]
    np.testing.assert_allclose(1.0 - words["mismatch"], conditions["weaker"]["model"]["B"][1])


def test_every_measured_claim_names_a_measure_and_rows_that_exist() -> None:
    """And the zone at the input is as wide as stated."""
    rows = TABLES["repaired"].keys() | TABLES["printed"].keys() | {""}
    for measure, *names in TABLES["measured"].values():
        assert callable(getattr(measures, measure))
        assert rows >= {*names}
    width = abs(1 + 2j * np.pi) ** 2 * D
    actuator = TABLES["conditions"]["zone at the input"]["actuator"]
    assert actuator == {"right": pytest.approx(width), "left": pytest.approx(width)}
