"""Ten verdicts, drawn by a published seed, agree with a computation that shares no code."""

from __future__ import annotations

import ast
import random
from pathlib import Path

import numpy as np
import pytest
from benchmarks.end_to_end import paper_recomputed

from undeadzone_paper import Paper
from undeadzone_paper.claims import read_claim_texts

EXACT = ("state-2", "global", "unknown-width", "theorem", "width-bound", "bounded", "tracking")
"""Claims whose runs have no noise in what is measured: their numbers agree, not verdicts alone."""


def test_ten_verdicts_drawn_by_the_seed_are_found_again(paper: Paper) -> None:
    claims = {claim.text.id: claim for claim in paper.claims}
    found = paper_recomputed.verdicts()
    assert len(found) == 10
    for name, (again, verdict) in found.items():
        claim = claims[name]
        assert verdict == claim.verdict, name
        if name not in EXACT:
            continue
        for mine, theirs in (
            (again.printed, claim.worst_printed),
            (again.repaired, claim.repaired),
        ):
            assert mine is not None
            assert theirs is not None
            assert np.isinf(mine) == np.isinf(theirs), name
            if np.isfinite(mine):
                assert mine == pytest.approx(theirs, rel=0.1, abs=1e-12), name


def test_the_draw_is_that_of_the_seed() -> None:
    ids = sorted(text.id for text in read_claim_texts())
    assert paper_recomputed.draw_claims() == random.Random(58).sample(ids, 10)


def test_the_script_shares_no_code_with_the_package() -> None:
    tree = ast.parse(Path(paper_recomputed.__file__).read_text(encoding="utf-8"))
    names = [
        module
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for module in (
            [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else [a.name for a in node.names]
        )
    ]
    assert names
    assert not [name for name in names if "undeadzone" in name or "benchmarks" in name]
