"""Elements of the input: the order of the plant behind them, and what rounding makes of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from records import dead_zone
from undeadzone_identify.models.chain import ChainFit, ChainModel
from undeadzone_identify.models.least_squares import LeastSquares
from undeadzone_identify.models.place import WIDTHS, PlaceModel, PlaceShape, fit_place, raise_order
from undeadzone_identify.models.plant import PlantSimulator, RecordData
from undeadzone_identify.selection.location import is_rounding_play

SIZE = 400


def records(rng: np.random.Generator, poles: list[float], noise: float) -> RecordData:
    """Two records behind a zone of the input of 0.4 and 0.3."""
    u = np.repeat(rng.standard_normal(SIZE // 4), 4)
    passed = dead_zone(u, 0.4, 0.3)
    denominator = np.poly(poles)
    z = lfilter([0.0, denominator.sum()], denominator, passed)
    y = z + noise * rng.standard_normal(SIZE)
    ones = np.ones(SIZE)
    return RecordData(
        u=u[:, None],
        y=y,
        ok=np.ones(SIZE, bool),
        start=np.array([0, SIZE // 2]),
        side=np.sign(y).astype(int),
        u_scale=ones[:1],
        y_scale=1.0,
        silent_zeros=False,
    )


def fit_first_order(data: RecordData) -> tuple[PlantSimulator, np.ndarray]:
    """A first-order plant behind zones of 0.4 and 0.3, as a start point."""
    simulator = PlantSimulator(data, 1)
    model = PlaceModel(simulator, PlaceShape("input", input=True))
    theta = np.zeros(model.base + WIDTHS + model.n)
    theta[: simulator.layout.right] = [-0.9, 0.1, 0.0, 0.0]
    model.part_numbers(theta, "input")[:] = 0.4, 0.3
    return simulator, theta


@given(st.integers(0, 1000), st.floats(0.3, 0.85), st.floats(0.86, 0.95))
@settings(max_examples=8, deadline=None)
def test_a_second_lag_behind_a_zone_of_the_input_is_found(
    seed: int, fast: float, slow: float
) -> None:
    data = records(np.random.default_rng(seed), [fast, slow], 0.003)
    simulator, theta = fit_first_order(data)
    first = fit_place(simulator, PlaceShape("input", input=True), [theta])
    assert first is not None
    second = raise_order(first)
    assert second is not None
    assert second.model.n == 2
    assert second.density.bic < first.density.bic
    assert second.density.rms == pytest.approx(0.003, rel=0.2)
    assert second.model.part_numbers(second.theta, "input") == pytest.approx([0.4, 0.3], abs=0.02)


def test_a_plant_of_the_next_order_is_not_worse() -> None:
    """It holds the plant of this order: what it gains does not pay for its numbers."""
    data = records(np.random.default_rng(2), [0.9], 0.01)
    simulator, theta = fit_first_order(data)
    first = fit_place(simulator, PlaceShape("input", input=True), [theta])
    assert first is not None
    second = raise_order(first)
    assert second is not None
    assert second.density.rms < 1.001 * first.density.rms
    assert second.density.bic > first.density.bic


@pytest.mark.parametrize(("gap", "is_rounding"), [(0.02, True), (0.025, False)])
def test_a_play_that_moves_less_than_a_rounded_reading_is_rounding(
    gap: float, is_rounding: bool
) -> None:
    """A loop around an encoder at an operating point had a play of 0.013 with odds of 1.00."""
    data = records(np.random.default_rng(3), [0.9], 0.01)
    squares = LeastSquares(ChainModel(PlantSimulator(data, 1), "play"))
    theta = np.zeros(squares.model.filter.stop)
    theta[:2] = -0.9, 0.2  # a gain of 2: 1.5 quanta are 0.0225 of the input
    theta[squares.model.inputs] = gap
    fit = ChainFit(squares, theta, squares.autoregressive_density(theta))
    assert is_rounding_play(fit, 0.03) == is_rounding
