"""Where climbs to a servo begin."""

from __future__ import annotations

import math

import numpy as np

from undeadzone_identify.servo.likelihood import At, discretise_servo
from undeadzone_identify.servo.observations import Observations
from undeadzone_identify.servo.search import _frictionless_output


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
