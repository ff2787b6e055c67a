"""Gains from poles: the closed loop has them, python-control agrees, others are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes import PAPER_PLANT, random_plant, seeds
from undeadzone.errors import StructureError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import (
    _ackermann_gain,
    _multi_input_gain,
    observer_gain,
    parse_poles,
    pole_placement_gain,
    state_gain,
)


def poles_of(A: Any) -> Any:
    return np.sort_complex(np.linalg.eigvals(A))


@given(seeds, st.integers(1, 5), st.integers(1, 2))
def test_closed_loop_and_observer_have_the_requested_poles(
    seed: int, n: int, channels: int
) -> None:
    rng = np.random.default_rng(seed)
    linear = random_plant(rng, n, channels, channels, stable=False).linear
    poles = np.array(-rng.uniform(0.5, 3, n), complex)
    if n > 1:
        poles[1] = -1 + 2j
        poles[0] = poles[1].conj()
    A, B, C = linear
    expected = pytest.approx(np.sort_complex(poles), abs=1e-4)
    assert poles_of(A - B @ state_gain(linear, poles, None)) == expected
    assert poles_of(A - observer_gain(linear, poles, None) @ C) == expected


def test_the_papers_gains() -> None:
    """Poles (-4, -10) of (39) need L = (12, 15), not the (-1.25, -1.62) of (40).

    With those A - L C is unstable.
    """
    A, _, C = PAPER_PLANT.linear
    assert observer_gain(PAPER_PLANT.linear, [-4.0, -10.0], None).ravel() == pytest.approx([12, 15])
    assert poles_of(A - np.array([[-1.25], [-1.62]]) @ C) == pytest.approx([-2.18, 1.43], abs=0.005)
    assert state_gain(PAPER_PLANT.linear, [-4.0, -10.0], None).ravel() == pytest.approx([39, 12])


def test_agrees_with_python_control() -> None:
    import control

    A, B, C = random_plant(np.random.default_rng(5), 4, 2, 2).linear
    poles = [-1.0, -2.0, -3.0, -4.0]
    single = Matrices(A, B[:, :1], C[:1])
    K = np.asarray(control.place(A, B[:, :1], poles))
    L = np.asarray(control.place(A.T, C[:1].T, poles)).T
    assert state_gain(single, poles, None) == pytest.approx(K, rel=1e-6)
    assert observer_gain(single, poles, None) == pytest.approx(L, rel=1e-6)


def test_ackermanns_formula_is_scipys_gain_of_one_input() -> None:
    A, B, _ = random_plant(np.random.default_rng(6), 3).linear
    poles = np.array([-1.0, -2.0, -3.0])
    assert pytest.approx(_multi_input_gain(A, B, poles, "p"), rel=1e-6) == _ackermann_gain(
        A, B, poles, "p"
    )


@pytest.mark.parametrize("Ts", [1e-4, 1e-2, 0.3])
def test_sampled_poles_are_the_exponentials(Ts: float) -> None:
    sampled = zoh(PAPER_PLANT.linear, Ts)
    A, B, C = sampled
    expected = np.sort_complex(np.exp(np.array([-4 - 3j, -4 + 3j]) * Ts))
    K = state_gain(sampled, [[-4, 3], [-4, -3]], Ts)
    L = observer_gain(sampled, [[-4, 3], [-4, -3]], Ts)
    assert poles_of(A - B @ K) == pytest.approx(expected, abs=1e-9)
    assert poles_of(A - L @ C) == pytest.approx(expected, abs=1e-9)


def test_sampled_gains_tend_to_the_continuous_ones() -> None:
    Ts = 1e-5
    sampled = zoh(PAPER_PLANT.linear, Ts)
    K = state_gain(sampled, [-4, -10], Ts)
    L = observer_gain(sampled, [-4, -10], Ts)
    assert pytest.approx(np.array([[39.0, 12.0]]), rel=1e-3) == K
    assert L / Ts == pytest.approx(np.array([[12.0], [15.0]]), rel=1e-3)


def test_poles_are_read_from_numbers_and_pairs() -> None:
    assert parse_poles("p", [-1, -2.5], 2).tolist() == [-1, -2.5]
    assert parse_poles("p", [[-1, 2], [-1, -2], [-3, 0]], 3).tolist() == [-1 + 2j, -1 - 2j, -3]
    assert parse_poles("p", [-1 + 2j, -1 - 2j], 2).tolist() == [-1 + 2j, -1 - 2j]
    assert parse_poles("p", [[-1, 0], [-2, 0]], 2).tolist() == [-1, -2]


def test_poles_that_cannot_be_placed() -> None:
    A = np.diag([-1.0, -2.0, -3.0])
    with pytest.raises(StructureError, match="p: the poles cannot be placed"):
        pole_placement_gain(A, np.array([[1.0], [1.0], [0.0]]), np.array([-4, -5, -6]), "p")
    with pytest.raises(StructureError, match=r"p: the poles cannot be placed: .*repeated"):
        pole_placement_gain(
            A, np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), np.array([-4, -4, -4]), "p"
        )
    with pytest.raises(StructureError, match="nearly uncontrollable"):
        pole_placement_gain(
            np.diag(np.arange(1.0, 13.0)), np.ones((12, 1)), -np.arange(1.0, 13.0), "p"
        )


def test_fast_poles_are_placed_as_accurately_as_slow_ones() -> None:
    K = pole_placement_gain(
        np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.array([-1e5, -2e5]), "K"
    )
    np.testing.assert_allclose(K, [[2e10, 3e5]], rtol=1e-12)


def test_a_gain_of_which_some_entries_are_not_finite_is_refused() -> None:
    """The square of the last entry of A overflows, which spoils one entry of K."""
    A, B = np.array([[0.0, 1.0], [1.0, 1e200]]), np.array([[0.0], [1.0]])
    with np.errstate(all="ignore"), pytest.raises(StructureError, match="too far apart"):
        pole_placement_gain(A, B, np.array([-1.0, -2.0], complex), "controller.poles")
