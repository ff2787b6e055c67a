"""Records, and the plant along them."""

from __future__ import annotations

import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.prepare import _least_by_passage
from undeadzone_identify.models.plant import Layout, PlantSimulator, RecordData


def record(u: Floats, y: Floats, side: Floats) -> RecordData:
    """A record without gaps."""
    ok, start = np.ones(y.size, bool), np.zeros(1, int)
    return RecordData(u[:, None], y, ok, start, side.astype(int), False, np.ones(1), 1.0)


def test_a_passage_has_its_least_reading_at_both_ends() -> None:
    y = np.array([0.0, 0.5, 0.9, 0.7, 0.0, 0.6, 0.0, -0.4])
    data = record(y, y, np.sign(y))
    np.testing.assert_allclose(_least_by_passage(data, 1), [0.5, 0.6, 0.7])
    np.testing.assert_allclose(_least_by_passage(data, -1), [0.4])


def test_gradients_of_a_plant_are_those_of_differences() -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=60)
    simulator = PlantSimulator(record(u, u, np.sign(u)), 2)
    layout = simulator.layout
    assert isinstance(layout, Layout)
    theta = np.zeros(layout.right)
    theta[layout.denominator] = [-1.2, 0.45]
    theta[layout.numerators] = [0.3, -0.1]
    theta[layout.x0] = [0.2, -0.3]
    slopes = simulator.z_gradient(theta, simulator.simulate_z(theta))[:, : layout.right]
    for k in range(layout.x0.stop):
        move = np.zeros(theta.size)
        move[k] = 1e-6
        more, less = simulator.simulate_z(theta + move), simulator.simulate_z(theta - move)
        np.testing.assert_allclose(slopes[:, k], (more - less) / 2e-6, rtol=1e-5, atol=1e-8)
