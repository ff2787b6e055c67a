"""Where climbs to a servo begin."""

from __future__ import annotations

import math

import numpy as np
import pytest
from benchmarks.identify.logs.servo import Servo as Truth
from benchmarks.identify.logs.servo import input_at_random, recorded, torque_at_random

from records import holds
from undeadzone_identify.servo.gap import identify_servo_gap
from undeadzone_identify.servo.likelihood import At, Servo, ServoStructure, discretise_servo
from undeadzone_identify.servo.observations import Observations, build_observations
from undeadzone_identify.servo.search import (
    EXCHANGED,
    _frictionless_output,
    exchange_gap_and_friction,
)


def test_a_servo_without_friction_is_simulated_alike_by_states_and_by_a_filter() -> None:
    rng = np.random.default_rng(7)
    u, zero = rng.normal(size=80), np.zeros(80)
    u[0] = 0.0
    theta = np.zeros(len(At))
    theta[[At.DAMPING, At.GAIN, At.DELAY]] = math.log(3.0), 2.0, 0.0
    theta[[At.SPRING, At.POLE, At.SLOW]] = -math.inf, math.inf, -math.inf
    whole = np.ones(80, bool)
    step = 0.05
    sides, first = zero.astype(int), np.zeros(1, int)
    log = Observations(
        *(step, step, u, zero, whole, first, False, 0.0, sides, zero),
        *(1.0, 1.0, 1.0),
    )
    A, B, _ = discretise_servo(theta[None], step, False)
    x, z = np.zeros(2), np.zeros(80)
    for k in range(79):
        x = A[0, :2, :2] @ x + B[0, :2, 0] * u[k]
        z[k + 1] = x[0]
    np.testing.assert_allclose(_frictionless_output(log, theta, False), z, atol=1e-12)


def test_what_is_lost_at_a_reversal_stays_if_gap_and_friction_are_exchanged() -> None:
    """c + 2 f g / k; without a spring there is nothing to exchange."""
    theta = np.zeros(len(At))
    theta[[At.SPRING, At.GAIN, At.GAP, At.FRICTION]] = math.log(800.0), -20.0, 0.5, 0.1
    theta[[At.POLE, At.SLOW]] = math.inf, 0.3
    one = Servo(ServoStructure(frozenset({"spring", "friction", "slow"})), theta, 0.0)
    lost = 0.5 + 2 * 0.1 * 20 / 800
    found = exchange_gap_and_friction(one)
    assert len(found) == len(EXCHANGED)
    for other in found:
        assert other.structure.parts == {"spring", "friction"}
        again = other.theta[At.GAP] + 2 * other.theta[At.FRICTION] * 20 / 800
        assert again == pytest.approx(lost)
        assert other.theta[At.GAP] != theta[At.GAP]
    assert found[0].theta[At.GAP] == pytest.approx(0.05 * 0.5)
    assert exchange_gap_and_friction(one._replace(structure=ServoStructure(frozenset()))) == []


def test_friction_beside_a_spring_is_no_part_of_the_gap() -> None:
    """In slow motion friction loses three times what the gap does. Once all was taken for a gap."""
    draw = np.random.default_rng([53, 3, 1919, 300])
    draw.random(7)  # of the numbers of this servo, which are written out
    step, size = 0.01, 2000
    truth = Truth(25.410906, 19.000175, 842.13892, 0.0, 0.3, 0.004597909, 0.0, 0, 0.0, 0.0)
    command = input_at_random(draw, size)
    torque = 0.3 * torque_at_random(draw, size, step)
    draw.random(2)
    noise = 1.845e-4 * draw.standard_normal(size)
    u, y = recorded(truth, step, command, torque, noise, False)
    whole = np.ones(size, bool)
    found = identify_servo_gap(build_observations(u, y, whole, np.zeros(1, int), step))
    assert found is not None
    assert {"friction", "spring"} <= found.servo.structure.parts
    assert holds(found.gap, truth.gap)
    assert found.gap.high < 0.5 * (truth.gap + 2 * truth.friction * truth.gain / truth.spring)
