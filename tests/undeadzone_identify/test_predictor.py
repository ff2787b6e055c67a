"""The motor and its gear within a sample."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import pytest

from undeadzone_identify.servo.predictor import contact_share, step_motor


@pytest.mark.parametrize(
    ("z", "v", "share"),
    [
        (0.15, 1.0, 1.0),  # at the edge of the gap already
        (0.05, 1.0, 0.5),  # half a sample from it
        (-0.05, 1.0, 0.0),  # more than a sample from it
        (-0.05, -1.0, -0.5),
        (0.1, 0.0, 1.0),  # at rest against the load
        (0.05, 0.0, 0.0),
        (-0.1, 0.0, -1.0),
    ],
)
def test_a_gear_pushes_from_the_edge_of_the_gap_on(z: float, v: float, share: float) -> None:
    """A gap of 0.2 about the load at 0, and 0.1 of it in a sample."""
    lane: Any = SimpleNamespace(gap=0.2, step=0.1)
    assert float(contact_share(lane, ca.DM(z), ca.DM(v), 0.0)) == pytest.approx(share)


def test_a_motor_without_friction_is_a_linear_system() -> None:
    """Each number of its matrices acts on its own state."""
    matrix = {"a00": 0.9, "a01": 0.1, "a02": 0.02, "a03": 0.03, "bz": 0.04, "fz": 0.05}
    matrix |= {"a10": -0.7, "a11": 0.8, "a12": 0.12, "a13": 0.13, "bv": 0.14, "fv": 0.15}
    rest = {"a22": 0.95, "a33": 0.6, "bi": 0.4, "friction": 0.0, "load": 0.0, "step": 0.1}
    lane: Any = SimpleNamespace(**matrix, **rest)
    z, v, d, i, u, torque = 2.0, 3.0, 5.0, 7.0, 11.0, 13.0
    motion = step_motor(lane, [ca.DM(one) for one in (z, v, d, i)], u, torque, 0.0)
    expected = [
        0.9 * z + 0.1 * v + 0.02 * d + 0.03 * i + 0.04 * u + 0.05 * torque,
        -0.7 * z + 0.8 * v + 0.12 * d + 0.13 * i + 0.14 * u + 0.15 * torque,
        0.95 * d,
        0.6 * i + 0.4 * u,
    ]
    assert [float(one) for one in motion.x] == pytest.approx(expected)
    assert not bool(motion.rests)
