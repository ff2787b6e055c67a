"""Which runs stand behind the claims."""

from __future__ import annotations

import numpy as np

from undeadzone_paper import Paper, measures
from undeadzone_paper.evidence import CONDITIONS, TABLES


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
    for measure, printed, repaired in TABLES["measured"].values():
        assert callable(getattr(measures, measure))
        assert printed in TABLES["printed"]
        assert repaired in TABLES["repaired"]
