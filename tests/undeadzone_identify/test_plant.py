"""Records, and the plant along them."""

from __future__ import annotations

import numpy as np
import pytest

from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.prepare import _least_by_passage
from undeadzone_identify.models.plant import PlantSimulator, RecordData


def record(u: Floats, y: Floats, side: Floats) -> RecordData:
    """A record without gaps."""
    ok, start = np.ones(y.size, bool), np.zeros(1, int)
    return RecordData(u[:, None], y, ok, start, side.astype(int), False, np.ones(1), 1.0)


def test_a_passage_has_its_least_reading_at_both_ends() -> None:
    y = np.array([0.0, 0.5, 0.9, 0.7, 0.0, 0.6, 0.0, -0.4])
    data = record(y, y, np.sign(y))
    np.testing.assert_allclose(_least_by_passage(data, 1), [0.5, 0.6, 0.7])
    np.testing.assert_allclose(_least_by_passage(data, -1), [0.4])


@pytest.mark.parametrize("m", [1, 2])
def test_gradients_of_a_plant_are_those_of_differences(m: int) -> None:
    rng = np.random.default_rng(2)
    u = rng.normal(size=(60, m))
    data = record(u[:, 0], u[:, 0], np.sign(u[:, 0]))._replace(u=u, u_scale=np.ones(m))
    simulator = PlantSimulator(data, 2)
    layout = simulator.layout
    theta = rng.normal(size=layout.right)
    theta[layout.denominator] = [-1.2, 0.45]
    slopes = simulator.z_gradient(theta, simulator.simulate_z(theta))[:, : layout.right]
    for k in range(layout.x0.stop):
        move = np.zeros(theta.size)
        move[k] = 1e-6
        more, less = simulator.simulate_z(theta + move), simulator.simulate_z(theta - move)
        np.testing.assert_allclose(slopes[:, k], (more - less) / 2e-6, rtol=1e-4, atol=1e-7)
