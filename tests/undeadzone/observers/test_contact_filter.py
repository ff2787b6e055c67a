"""Parts of the filter of geared arms, on numbers that are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import pytest

from undeadzone.numerics.gaussian import Gaussian
from undeadzone.observers.contact_filter.drive import (
    build_drive,
)
from undeadzone.observers.contact_filter.modes import Layout, condition_on_impact
from undeadzone.plants.robots.build import build_two_link
from undeadzone.plants.robots.geared import Gears, build_geared_arm

GEARS = build_geared_arm(build_two_link(), Gears(half=0.05, inertia=[0.08, 0.03]))


@pytest.mark.parametrize("joint", [0, 1])
def test_a_link_that_struck_half_a_sample_ago_has_the_gap_that_was_foretold(joint: int) -> None:
    """It is as far beyond its flank as motor and link have closed since then."""
    layout, step = Layout(2), 1e-3
    mean = ca.DM.zeros(layout.entry_count)
    mean[layout.slice_of("half")] = 0.05
    mean[layout.slice_of("motor_speed").start + joint] = 2.0
    mean[layout.slice_of("link_speed").start + joint] = -1.0
    mean[layout.slice_of("motor").start + joint] = 0.05 + 3.0 * step / 2
    belief = Gaussian(ca.SX(mean), 1e-4 * ca.SX.eye(layout.entry_count))
    q: Any = SimpleNamespace(model=GEARS.values, slack=1e-8, impact=0.3)
    after = condition_on_impact(build_drive(GEARS, step, 1), q, joint, 1, belief)
    assert float(after.mean[layout.slice_of("half").start + joint]) == pytest.approx(
        0.05, abs=1e-12
    )
