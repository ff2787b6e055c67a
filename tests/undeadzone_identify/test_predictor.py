"""The motor and its gear within a sample."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from undeadzone.compile import lanes
from undeadzone_identify.servo.predictor import (
    COVARIANCE,
    LATEST,
    MEAN,
    NUMBERS,
    contact_share,
    step_motor,
    tick_predictor,
)


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
    matrix = {"a00": 0.9, "a01": 0.1, "a02": 0.02, "a03": 0.03, "b00": 0.04, "b01": 0.05}
    matrix |= {"a10": -0.7, "a11": 0.8, "a12": 0.12, "a13": 0.13, "b10": 0.14, "b11": 0.15}
    rest = {"a22": 0.95, "a33": 0.6, "b30": 0.4, "friction": 0.0, "load": 0.0, "step": 0.1}
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


@pytest.mark.parametrize(("v", "fallen"), [(3.0, 0.04), (8.0, 0.0)])
def test_a_tick_past_a_peak_was_at_the_peak(v: float, fallen: float) -> None:
    """A motor brakes by 5 in a sample of 0.1 s: from 3 it turns and falls by 2^2 / (2 * 50)."""
    braking, step, quantum, boundary = 50.0, 0.1, 1e-3, 0.5
    numbers = dict.fromkeys(NUMBERS, 0.0) | {
        **{"a00": 1.0, "a01": step, "a11": 1.0, "b00": -(step**2) / 2, "b10": -step},
        **{"quantum": quantum, "step": step, "rms": 0.002},
    }
    taps, inputs = np.eye(LATEST + 1)[0], np.full(LATEST + 1, braking)
    params = np.concatenate([[numbers[name] for name in NUMBERS], taps])
    state = np.zeros(MEAN + COVARIANCE + 1)
    state[1] = v
    tick = [1.0, boundary, 0.0, 0.0, 0.0, 1.0]  # side, boundary; no reversal, not the first
    signals = np.concatenate([inputs, tick])[None]
    seen, _ = lanes.run_lanes(
        tick_predictor(), state[None], signals, params, lane_params=params[None]
    )
    error, log_s, at, speed = seen[0, 0]
    assert (at, speed) == pytest.approx((v * step - braking * step**2 / 2, v - braking * step))
    assert error == pytest.approx(boundary + quantum / 2 - fallen - at)
    variance = quantum**2 / 12 + 0.002**2 + fallen**2
    assert np.exp(2 * log_s) == pytest.approx(variance)
