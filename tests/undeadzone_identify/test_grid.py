"""Grids of a log's times and of its readings."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.errors import FileError
from undeadzone_identify.logs.grid import (
    _fill_regular,
    _resample_log,
    common_spacing,
    find_sample_time,
)
from undeadzone_identify.logs.log import log_from_arrays


def test_inputs_on_a_new_grid_are_those_from_their_own_time_on() -> None:
    t = np.arange(0.0, 4.0, 0.1)
    log = log_from_arrays(u=t.copy(), y=t.copy(), t=t)
    piece = _resample_log(log, 0.2, [])
    np.testing.assert_allclose(piece.u[:, 0], piece.t, atol=1e-12)
    np.testing.assert_allclose(piece.y, piece.t, atol=1e-12)


def test_a_divisor_of_moves_far_from_0_is_found() -> None:
    """The first value is no multiple of the divisor."""
    assert common_spacing(100.1 + 0.25 * np.array([0, 1, 3, 4, 9, 14])) == pytest.approx(0.25)
    assert common_spacing(np.sort(np.random.default_rng(3).normal(size=9))) == 0.0


@pytest.mark.parametrize("inputs", [1, 2])
def test_in_a_gap_the_last_inputs_are_repeated(inputs: int) -> None:
    t = np.delete(np.arange(20) * 0.1, [4, 5, 6])
    u = np.column_stack([t, 10 * t])[:, :inputs]
    log = log_from_arrays(u=u, y=t.copy(), t=t)
    remarks: list[str] = []
    piece = _fill_regular(log, 0.1, remarks)
    zoh_input = np.arange(20) * 0.1
    zoh_input[4:7] = 0.3
    np.testing.assert_allclose(
        piece.u, np.column_stack([zoh_input, 10 * zoh_input])[:, :inputs], atol=1e-12
    )
    assert np.isnan(piece.y[4:7]).all()
    assert piece.start.tolist() == [0]
    assert "3 readings missing" in remarks[0]


@pytest.mark.parametrize("late", [0.009, 0.015])
def test_steps_may_differ_by_1_percent(late: float) -> None:
    """Times of eight digits; one sample comes late by a part of a step."""
    t = np.arange(200) * np.pi / 100
    t[100] += late * np.pi / 100
    log = log_from_arrays(u=t.copy(), y=t.copy(), t=t)
    if late < 0.01:
        assert find_sample_time(log) == pytest.approx(np.pi / 100)
    else:
        with pytest.raises(FileError, match="2 of 199 steps differ by more than 1 %"):
            find_sample_time(log)
