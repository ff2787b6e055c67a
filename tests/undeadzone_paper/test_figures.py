"""Figures 3-8 alone, V in a figure of its own, z beside the reference, Theorem 4.1."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone_paper import Paper
from undeadzone_paper.equations import FIGURES
from undeadzone_paper.evidence import BEGUN, NOMINAL, RESTING
from undeadzone_paper.figures import (
    RunTrio,
    plot_pair,
    plot_theorem,
)
from undeadzone_paper.page import claims_text
from undeadzone_paper.theorem import AS_PRINTED


@pytest.fixture(scope="module")
def runs(paper: Paper) -> RunTrio:
    evidence = paper.evidence
    printed = evidence.printed[NOMINAL]
    return RunTrio(printed[RESTING][1], printed[BEGUN][1], evidence.repaired["begun"][1])


@pytest.mark.parametrize("number", FIGURES)
def test_a_figure_of_the_paper_has_two_panels_and_none_of_V(number: int, runs: RunTrio) -> None:
    figure = plot_pair(f"figure_{number}", runs, "r")
    assert len(figure.axes) == 2
    assert not [axes for axes in figure.axes if axes.get_ylabel() == "V"]
    assert figure.get_suptitle().startswith(f"Figure {number}: ")


def test_both_panels_begin_at_the_same_state(runs: RunTrio) -> None:
    np.testing.assert_array_equal(runs.begun.x[0], runs.repaired.x[0])


def test_V_and_tracking_have_figures_of_their_own(runs: RunTrio) -> None:
    assert [axes.get_ylabel() for axes in plot_pair("V", runs, "r").axes] == ["V", "V"]
    printed, repaired = plot_pair("tracking", runs, "r").axes
    lines = {str(line.get_label()): line for line in repaired.lines}
    early = runs.repaired.t <= 6.0
    np.testing.assert_array_equal(lines["z"].get_ydata(), runs.repaired.z[early, 0])
    np.testing.assert_array_equal(
        lines["\u03b8 desired"].get_ydata(), 2 * np.sin(2 * np.pi * runs.repaired.t[early])
    )
    assert "from rest" in {line.get_label() for line in printed.lines}


def test_the_figure_of_the_theorem_shows_both_laws_and_every_reading_that_survives(
    paper: Paper,
) -> None:
    evidence = paper.evidence
    figure = plot_theorem(evidence.law, evidence.repaired[NOMINAL][0], evidence.theorem)
    state, _, readings = figure.axes
    assert {line.get_label() for line in state.lines} == {"given", "estimated", "repaired"}
    count = sum(len(np.asarray(line.get_xdata())) for line in readings.lines[:2])
    survived = [
        outcome
        for outcome in evidence.theorem
        if outcome.variant.law == AS_PRINTED and outcome.diverged_at is None
    ]
    assert count == len(survived)


def test_captions_say_what_was_found_and_where_text_and_caption_conflict(paper: Paper) -> None:
    assert "figures-3-4 (not shown)" in claims_text(3, paper.claims)
    assert "beta (not shown)" in claims_text(8, paper.claims)
