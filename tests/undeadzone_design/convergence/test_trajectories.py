"""Worst trajectories along schedules: modes, windows and settling times."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_identifiability import visiting

from scenes import PAPER_PLANT
from undeadzone.analysis.certificate.passivity import certify
from undeadzone_design.convergence import trajectories
from undeadzone_design.convergence.trajectories import worst_settling_time


@pytest.mark.parametrize("window", [2, 4])
def test_a_fair_adversary_takes_each_full_mode_in_every_window(
    monkeypatch: pytest.MonkeyPatch, window: int
) -> None:
    """Though the third mode, which is none, is the one that it likes best."""
    monkeypatch.setattr(trajectories, "_value", lambda V, errors: np.abs(errors).sum(axis=1))
    maps = np.array([0.5, 0.6, 1.1])[:, None, None] * np.eye(2)
    moves = trajectories._Moves(maps, np.array([0, 1]), window)
    V: Any = None
    modes = trajectories._adversary_modes(V, np.ones(2), moves, fair=True)
    for one in modes.reshape(-1, window):
        assert set(one) >= {0, 1}
    assert set(trajectories._adversary_modes(V, np.ones(2), moves, fair=False)) == {2}


@pytest.mark.parametrize("Ts", [None, 0.02])
def test_a_pass_lasts_as_long_as_its_schedule(Ts: float | None) -> None:
    schedule = visiting([True], [True], Ts)
    errors: Any = SimpleNamespace(A=np.zeros((1, 2, 2)), Ts=Ts, C=np.ones((1, 2)))
    modes = trajectories._modes_of_schedule(errors, schedule, 2 * schedule.total_duration)
    lengths = schedule.spans * (Ts or 1.0)
    assert [mode.seconds for mode in modes[:6]] == pytest.approx([*lengths, *lengths])


def test_errors_may_need_many_passes_to_settle() -> None:
    """A schedule of 1.5 ms, passed thousands of times; the count is the least that suffices."""
    found = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    usual = visiting([True], [True])
    brief = usual._replace(spans=usual.spans / 1000)
    slow = worst_settling_time(found.dynamics, found.V, usual)
    fast = worst_settling_time(found.dynamics, found.V, brief)
    assert slow is not None
    assert fast is not None
    assert fast / brief.total_duration > 1000
    assert fast == pytest.approx(slow, rel=0.5)


def test_V_begins_at_1_whatever_the_size_of_the_error() -> None:
    found = certify(PAPER_PLANT.linear, np.array([[1.0], [1.5]]), np.array([10.0]))
    assert found.V is not None
    maps, times = np.array([0.5, 0.6])[:, None, None] * np.eye(4), np.array([0.1, 0.3])
    for size in (1.0, 3.0):
        start = size * np.array([1.0, -2.0, 0.5, 0.0])
        seen = trajectories._trajectory_along_maps("hand", found.V, start, maps, times)
        np.testing.assert_allclose(seen.V, [1.0, 0.25, 0.09], rtol=1e-12)
