"""The parts of the search for a Pareto front: weights, neighbours, offers, scalar costs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from undeadzone.numerics.optimise import (
    NEIGHBOURS,
    TILT,
    _best_offers,
    _breed_children,
    _cost_range,
    _nearest_weights,
    _weight_grid,
    find_pareto_front,
    is_undominated,
    minimise_by_cmaes,
    scalar_costs,
)


def test_a_grid_of_weights_adds_up_to_1() -> None:
    grid = _weight_grid(3, 10)
    assert len(grid) == 66  # (10 + 2)! / (10! 2!)
    assert grid.sum(axis=1) == pytest.approx(np.ones(66))
    assert len(np.unique(grid, axis=0)) == 66


def test_neighbours_are_the_nearest_weights_oneself_first() -> None:
    weights = _weight_grid(2, 20)
    near = _nearest_weights(weights)
    assert near.shape == (21, NEIGHBOURS)
    assert near[:, 0].tolist() == list(range(21))
    assert sorted(near[0].tolist()) == list(range(NEIGHBOURS))


def test_offers_come_from_neighbours_alone() -> None:
    losses = np.array([[3.0, 1.0, 0.0], [5.0, 4.0, 6.0], [2.0, 9.0, 8.0]])
    near = np.array([[0, 1], [1, 2], [2, 1]])
    best, loss = _best_offers(losses, near)
    assert best.tolist() == [1, 1, 2]
    assert loss.tolist() == [1.0, 4.0, 8.0]


def test_the_scalar_cost_is_the_largest_weighted_loss_and_a_little_of_all() -> None:
    values = np.array([[1.0, 4.0], [3.0, 2.0]])
    cost = scalar_costs(values, np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([[0.5, 0.2]]))
    assert cost == pytest.approx(np.array([[0.2 + TILT * 0.2, 0.5 + TILT * 0.5]]))


def test_the_front_is_what_nothing_beats_and_frames_what_is_admitted() -> None:
    values = np.array([[1.0, 4.0], [2.0, 2.0], [3.0, 3.0], [5.0, 1.0], [np.inf, 0.0]])
    assert is_undominated(values[:4]).tolist() == [True, True, False, True]
    least, greatest = _cost_range(values)
    assert least.tolist() == [1.0, 1.0]
    assert greatest.tolist() == [5.0, 4.0]


def test_children_stay_in_the_box() -> None:
    rng = np.random.default_rng(0)
    low, high = np.array([-1.0, 2.0]), np.array([1.0, 3.0])
    points = rng.uniform(low, high, (21, 2))
    near = _nearest_weights(_weight_grid(2, 20))
    children = np.concatenate([_breed_children(rng, points, near, low, high) for _ in range(50)])
    assert ((children >= low) & (children <= high)).all()
    assert np.ptp(children, axis=0) == pytest.approx(high - low, rel=0.2)


def test_an_evolution_begins_at_its_start() -> None:
    low, high, start = np.array([-10.0, 100.0]), np.array([30.0, 108.0]), np.array([20.0, 101.0])
    tried: list[Any] = []

    def cost(points: Any) -> Any:
        tried.append(points)
        return np.zeros(len(points))

    minimise_by_cmaes(cost, low, high, seed=3, size=40, rounds=1, start=start, spread=0.01)
    np.testing.assert_allclose(tried[0].mean(axis=0), start, atol=0.01 * 40)


def test_an_evolution_takes_no_point_that_is_not_finite() -> None:
    def costs(points: Any) -> Any:
        both = np.stack([1 - points[:, 0], points[:, 0]], axis=1)
        both[points[:, 0] > 0.5, 1] = np.inf
        return both

    _, values = find_pareto_front(costs, np.zeros(1), np.ones(1), 1, np.array([[0.2]]), rounds=5)
    assert np.isfinite(values).all()
    assert len(values) > 1
