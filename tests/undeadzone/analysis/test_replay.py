"""Gaps of gears by logs that are replayed."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.analysis.identifiability.replay import weigh_gaps


@pytest.mark.parametrize(("struck", "sure"), [(12, True), (1, False)])
def test_many_windows_find_a_gap_and_one_never_does(struck: int, sure: bool) -> None:
    """Errors grow with the distance from a gap of 0.02, in some windows of 50 samples."""
    gap = np.linspace(0.0, 0.06, 31)
    wrong = np.random.default_rng(1).normal(size=(1000, 1)) * np.ones(32)
    wrong[250 : 250 + 50 * struck : 50, :-1] += 1800 * (gap - 0.02)
    mean, std = weigh_gaps(wrong, gap, 50)
    assert (std < 0.009) == sure
    assert abs(mean - 0.02) < 2 * std
