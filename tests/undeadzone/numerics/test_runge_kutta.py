"""The Rosenbrock step: its order with any matrix, and what becomes of stiff modes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from undeadzone.numerics.runge_kutta import GAMMA, rosenbrock_change
from undeadzone.util.arrays import Floats

TURN = np.array([[0.0, 1.0], [-4.0, -0.3]])


def moved(A: Floats, jacobian: Floats, x: Floats, h: float, steps: int) -> Floats:
    """x after steps of x' = A x - 0.2 x^3, with a matrix that the method is told."""
    inverse = np.linalg.inv(np.eye(2) - GAMMA * h * jacobian)
    for _ in range(steps):
        x = x + rosenbrock_change(lambda z: A @ z - 0.2 * z**3, lambda b: inverse @ b, x, h)
    return x


@pytest.mark.parametrize("jacobian", [TURN, 0.3 * TURN, np.zeros((2, 2))])
def test_the_error_falls_with_the_square_of_the_step_for_any_jacobian(jacobian: Floats) -> None:
    start, ends = np.array([1.0, 0.0]), []
    for steps in (40, 80, 160):
        ends.append(moved(TURN, jacobian, start, 2.0 / steps, steps))
    first, second = (np.abs(a - b).max() for a, b in itertools.pairwise(ends))
    assert first / second == pytest.approx(4.0, rel=0.15)


@pytest.mark.parametrize("rate", [1e1, 1e3, 1e6])
def test_a_stiff_mode_is_gone_and_a_slow_one_stays(rate: float) -> None:
    A = np.diag([-rate, -1.0])
    after = moved(A, A, np.array([1e-3, 1e-3]), 0.5, 1)
    assert abs(after[0]) < 0.3e-3
    assert after[1] == pytest.approx(np.exp(-0.5) * 1e-3, rel=0.02)
