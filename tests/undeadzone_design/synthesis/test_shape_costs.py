"""What `check` says of the sensor's shape, against runs of sensors that are told to be exact."""

from __future__ import annotations

import numpy as np
import pytest

from scenes import EXACT_SENSOR, scene
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.simulate import simulate
from undeadzone_design.synthesis.check import check


def looked_at(**sensor_options: float) -> Scenario:
    return scene(
        """
        observer = { method = "censored", right = [0.3, 2.0], levels = 1, tolerance = 0.0 }
        simulation = { time = "sampled", step = 0.02, duration = 6.0 }
        """,
        sensor={"right": 1.3, "left": 0.6, "noise": 0.02} | sensor_options,
    )


def test_parts_of_a_widths_interval_are_named() -> None:
    found = check(looked_at())
    (costs,) = found.shape
    width_std = simulate(looked_at(), check_step=False).width_std
    sure = simulate(looked_at(slope_std=0.0), check_step=False).width_std
    assert width_std is not None
    assert sure is not None
    assert costs["width"] == pytest.approx(width_std[-1, 0])
    assert costs["slope_std"] == pytest.approx(np.sqrt(width_std[-1, 0] ** 2 - sure[-1, 0] ** 2))
    assert max(costs, key=lambda name: costs[name]) == "width"
    assert "of which rounding" in repr(found)
    assert found.summary()["shape"] == pytest.approx(costs)


def test_an_exact_sensor_and_constant_gains_have_no_parts() -> None:
    assert check(looked_at(**EXACT_SENSOR)).shape == ()
    assert check(scene()).shape == ()
