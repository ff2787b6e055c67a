"""Theorem 4.1 with its own law: every reading once, as its own loop has it, counted."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.simulation.simulate import simulate
from undeadzone_paper import Paper
from undeadzone_paper.example import D
from undeadzone_paper.theorem import (
    AS_PRINTED,
    ESTIMATED,
    GIVEN,
    LAWS,
    READINGS_OF_THEOREM,
    count_theorem,
    example_of_theorem,
    is_kindest,
    select_outcomes,
)


def test_every_reading_is_run_once(paper: Paper) -> None:
    outcomes = paper.evidence.theorem
    assert READINGS_OF_THEOREM == 64
    assert len({outcome.variant for outcome in outcomes}) == len(outcomes) == 4 * 64


@pytest.mark.parametrize("index", [0, 7, 21, 40, 63, 64, 130, 190, 201, 255])
def test_a_reading_in_the_shared_graph_equals_its_own_loop(paper: Paper, index: int) -> None:
    outcome = paper.evidence.theorem[index]
    run = simulate(example_of_theorem(outcome.variant), check_step=False)
    largest = max(np.abs(part).max() for part in (run.x, run.x_hat, run.d_hat, run.u))
    assert (outcome.diverged_at is None) == (largest < 1e6)
    if outcome.diverged_at is None:
        last = run.t > run.t[-1] - 2.0 + 2.5e-3
        assert outcome.width_error == pytest.approx(
            np.abs(run.d_hat - D)[last].max(), rel=1e-6, abs=1e-9
        )
        assert outcome.state_error == pytest.approx(
            np.abs(run.x_hat - run.x)[last].max(), rel=1e-6, abs=1e-9
        )


def test_given_what_its_proof_needs_the_theorem_fails(paper: Paper) -> None:
    selected = select_outcomes(paper.evidence.theorem, GIVEN)
    assert len(selected) == 64
    assert sum(outcome.diverged_at is not None for outcome in selected) >= 10
    assert sum(outcome.worst_error <= 0.05 for outcome in selected) <= 12
    assert sum(outcome.leaves_true_widths for outcome in selected) >= 10
    kind = [outcome for outcome in selected if is_kindest(outcome.variant)]
    assert len(kind) == 8
    assert max(outcome.worst_error for outcome in kind) > 0.5


def test_counts_hold_every_outcome(paper: Paper) -> None:
    counts = count_theorem(paper.evidence.theorem)
    assert {(count.mismatch, count.law) for count in counts} == {
        (mismatch, law) for mismatch in (GIVEN, ESTIMATED) for law in LAWS
    }
    assert sum(count.total for count in counts) == 256
    for count in counts:
        assert count.diverge + count.end_right <= count.total


def test_claims_name_these_counts(paper: Paper) -> None:
    claim = next(claim for claim in paper.claims if claim.text.id == "theorem")
    diverge = sum(
        count.diverge
        for count in count_theorem(paper.evidence.theorem)
        if (count.mismatch, count.law) == (GIVEN, AS_PRINTED)
    )
    assert f"{diverge} of 64 readings diverge" in claim.text.why
    assert claim.verdict == "holds after repair"
