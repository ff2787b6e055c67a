"""Gaps of gears by logs that are replayed."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.analysis.identifiability.replay import weigh_gaps

GAP = np.linspace(0.0, 0.06, 31)
PRIOR = 0.06 / np.sqrt(12)


@pytest.mark.parametrize(
    ("struck", "scale", "sure"), [(12, 1.0, True), (12, 9.0, True), (1, 9.0, False)]
)
def test_many_windows_find_a_gap_and_one_never_does(struck: int, scale: float, sure: bool) -> None:
    """Errors grow with the distance from a gap of 0.02, in all windows or in one."""
    wrong = np.random.default_rng(1).normal(size=(1000, 32))
    wrong[:, :-1] = wrong[:, :1]
    for window in range(5, 5 + struck):
        wrong[50 * window, :-1] += 200 * scale * (GAP - 0.02)
    mean, std = weigh_gaps(scale * wrong, GAP, 50)
    assert (std < PRIOR / 2) == sure
    assert abs(mean - 0.02) < 2 * std
