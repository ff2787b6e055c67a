"""Grids of a log's times and of its readings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.grid import (
    _put_on_grid,
    common_spacing,
    find_quantum,
    find_sample_time,
    round_to_steps,
    to_grid,
)
from undeadzone_identify.logs.log import log_from_arrays


def test_inputs_on_a_new_grid_are_those_from_their_own_time_on() -> None:
    """Readings at every fourth of uneven stamps have a grid of their own."""
    t = np.cumsum(np.tile([0.05, 0.15], 200))
    grid = to_grid([log_from_arrays(u=t, y=np.where(np.arange(400) % 4, np.nan, t), t=t)])
    assert grid.ok.all()
    assert grid.step == pytest.approx(0.4)
    np.testing.assert_allclose([grid.u[:, 0], grid.y], [grid.t, grid.t], atol=1e-12)


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
    piece = _put_on_grid(log, 0.1, True, remarks)
    zoh_input = np.arange(20) * 0.1
    zoh_input[4:7] = 0.3
    np.testing.assert_allclose(
        piece.u, np.column_stack([zoh_input, 10 * zoh_input])[:, :inputs], atol=1e-12
    )
    assert np.isnan(piece.y[4:7]).all()
    assert np.flatnonzero(piece.begins).tolist() == [0]
    assert "3 readings missing" in remarks[0]


@pytest.mark.parametrize("sway", [0.03, 0.15])
def test_steps_may_sway_by_a_few_percent(sway: float) -> None:
    """Times of eight digits; every other sample comes late by a part of a step."""
    t = np.arange(200) * np.pi / 100
    t[::2] += sway * np.pi / 100
    log = log_from_arrays(u=t.copy(), y=t.copy(), t=t)
    step, is_regular = find_sample_time(log)
    assert is_regular == (sway < 0.05)
    assert step == pytest.approx(np.pi / 100, rel=0.01 if is_regular else 0.2)


def moved(size: int = 1500) -> Floats:
    """A slow motion of rms 1."""
    z = lfilter([1.0], [1.0, -1.9, 0.905], np.random.default_rng(2).standard_normal(size))
    return np.asarray(z / z.std())


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-6, 0.0), (1e6, 7.3e6), (1.0, 0.2)])
@pytest.mark.parametrize("noise", [0.02, 0.15])
def test_noise_about_steps_is_taken_off(scale: float, offset: float, noise: float) -> None:
    steps = 0.5 * np.round(moved() / 0.5)
    blurred = steps + 0.5 * noise * np.random.default_rng(3).standard_normal(steps.size)
    remarks: list[str] = []
    rounded = round_to_steps(scale * blurred + offset, remarks)
    is_off = np.abs(rounded - (scale * steps + offset)) > 0.1 * scale
    assert is_off.mean() < 0.005  # noise of more than half a step
    assert "gather about steps" in remarks[0]
    if offset == 0.0:
        assert find_quantum(rounded) == pytest.approx(0.5 * scale, rel=0.01)


def readings_without_steps() -> dict[str, Floats]:
    """Readings that are somewhere more often than elsewhere, and yet not rounded."""
    rng = np.random.default_rng(4)
    z, noise = moved(), 0.01 * rng.standard_normal(1500)
    levels = np.repeat(rng.integers(-3, 4, 50), 30).astype(float)
    return {
        "anywhere": z + noise,
        "within a zone": np.sign(z) * np.maximum(np.abs(z) - 0.5, 0.0) + noise,
        "a gate": np.where(np.abs(z) > 0.4, z, 0.0) + noise,
        "between limits": np.clip(z, -0.5, 0.5) + noise,
        "a relay": np.sign(z) + noise,
        "settled at levels": lfilter([0.2], [1.0, -0.8], levels) + noise,
        "rounded without noise": 0.5 * np.round(z / 0.5),
        "few": np.arange(5.0),
        "constant": np.ones(100),
        "huge": 1e308 * np.sign(z),
    }


@pytest.mark.parametrize("kind", readings_without_steps())
def test_readings_without_blurred_steps_stay(kind: str) -> None:
    y, remarks = readings_without_steps()[kind], list[str]()
    np.testing.assert_array_equal(round_to_steps(y, remarks), y)
    assert not remarks
