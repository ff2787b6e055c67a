"""Riccati equations and poles against collections and figures that others published."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg.tests.test_solvers import TestSolveContinuousAre as Carex
from scipy.linalg.tests.test_solvers import TestSolveDiscreteAre as Darex

from scenes import random_plant, seeds
from undeadzone.errors import StructureError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.poles import pole_placement_gain
from undeadzone.linalg.riccati import paper_riccati, solve_riccati
from undeadzone.util.arrays import Floats

REAL = [k for k, case in enumerate(Darex.cases) if not any(np.iscomplexobj(M) for M in case[:4])]
for published in (Carex, Darex):
    published.__test__ = False  # their data only


def model(A: Floats, B: Floats) -> Matrices:
    return Matrices(np.asarray(A, float), np.asarray(B, float), np.zeros((0, len(A))))


def test_there_are_twenty_cases() -> None:
    assert len(Carex.cases) == 20
    assert len(REAL) == 16


@pytest.mark.filterwarnings("ignore:An ill-conditioned matrix detected")
@pytest.mark.filterwarnings(
    "ignore:Input .a. has an eigenvalue pair:RuntimeWarning"
)  # of the nearly singular Newton step of the last case
@pytest.mark.parametrize(
    ("published", "k", "Ts"),
    [*((Carex, k, None) for k in range(20)), *((Darex, k, 1.0) for k in REAL)],
)
def test_published_cases(published: Any, k: int, Ts: float | None) -> None:
    """The collections CAREX and DAREX in scipy's tests: small residuals, stable loops.

    scipy marks five of the first as known failures; one of these because its data are unsigned
    bytes, which -Q wraps around.
    """
    A, B, Q, R = (np.atleast_2d(np.asarray(M, float)) for M in published.cases[k][:4])
    P, K, residual, _ = solve_riccati(model(A, B), Q, R, Ts)
    poles = np.linalg.eigvals(A - B @ K)
    if Ts is None:
        direct = A.T @ P + P @ A - P @ B @ np.linalg.solve(R, B.T @ P) + Q
        size = 2 * np.linalg.norm(A.T @ P) + np.linalg.norm(P @ B @ K)
        assert poles.real.max() < 0
    else:
        direct = A.T @ P @ (A - B @ np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)) - P + Q
        size = np.linalg.norm(P) + np.linalg.norm(A.T @ P @ A)
        assert np.abs(poles).max() < 1
    assert residual < 1e-10
    assert np.linalg.norm(direct) < 1e-10 * (np.linalg.norm(Q) + size)
    assert np.allclose(P, P.T, rtol=1e-12, atol=0)


def test_care_figures_of_octave() -> None:
    """The two examples in the tests of the Octave control package, to its four digits.

    The first is also MATLAB's.
    """
    c = np.array([[1.0, -1.0]])
    A, B = np.array([[-3.0, 2.0], [1.0, 1.0]]), np.array([[0.0], [1.0]])
    P, K, *_ = solve_riccati(model(A, B), c.T @ c, np.array([[3.0]]))
    assert pytest.approx(np.array([[0.5895, 1.8216], [1.8216, 8.8188]]), abs=1e-4) == P
    assert pytest.approx(np.array([[0.6072, 2.9396]]), abs=1e-4) == K
    assert np.sort(np.linalg.eigvals(A - B @ K)) == pytest.approx([-3.5026, -1.4370], abs=1e-4)
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    P, K, *_ = solve_riccati(model(A, B), np.eye(2), np.eye(1))
    assert pytest.approx(np.array([[1.7321, 1.0], [1.0, 1.7321]]), abs=1e-4) == P
    assert pytest.approx(np.array([[1.0, 1.7321]]), abs=1e-4) == K


def test_place_figures_of_octave() -> None:
    """Its examples for one input and for two; there K is not unique, but the figure's poles are."""
    K = pole_placement_gain(
        np.array([[0.0, 1.0], [3.0, 2.0]]),
        np.array([[0.0], [1.0]]),
        np.array([-1.0, -0.5]),
        "poles",
    )
    assert K.ravel() == pytest.approx([3.5, 3.5], abs=1e-14)
    A = np.array([[-6.8, 0, -207, 0], [1, 0, 0, 0], [43.2, 0, 0, -4.2], [0, 0, 1, 0]])
    B = np.array([[5.64, 0], [0, 0], [0, 1.18], [0, 0]])
    figure = -np.array([[-0.0876, -4.2138, 0.0837, -18.1412], [-0.0233, 18.2483, -0.4259, -4.8120]])
    poles = np.linalg.eigvals(A - B @ figure)
    K = pole_placement_gain(A, B, poles, "poles")
    placed = np.linalg.eigvals(A - B @ K)
    assert np.sort_complex(placed) == pytest.approx(np.sort_complex(poles), abs=1e-6)
    distance = np.abs(poles[:, None] - np.array([-0.5 + 0.15j, -0.5 - 0.15j])).min(axis=0)
    assert distance == pytest.approx([0, 0], abs=1e-3)


@settings(max_examples=25)
@given(seeds, st.integers(1, 6), st.integers(1, 3))
def test_agrees_with_python_control(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    linear = random_plant(rng, n, m).linear
    root = rng.normal(size=(m, m))
    Q, R = np.eye(n), root @ root.T + np.eye(m)
    P, K, *_ = solve_riccati(linear, Q, R)
    X, _, G = control.care(linear.A, linear.B, Q, R)
    assert np.allclose(P, X, rtol=1e-7, atol=1e-9)
    assert np.allclose(K, G, rtol=1e-7, atol=1e-9)
    sampled = zoh(linear, 0.1)
    P, K, *_ = solve_riccati(sampled, Q, R, 0.1)
    X, _, G = control.dare(sampled.A, sampled.B, Q, R)
    assert np.allclose(P, X, rtol=1e-7, atol=1e-9)
    assert np.allclose(K, G, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("m", [1, 2, 3])
def test_equation_34_is_the_optimal_one_with_half_the_gain(m: int) -> None:
    """K of (34) is half the gain that minimises int x'Qx + u'u/(2 alpha), for any inputs.

    A - BK is stable all the same.
    """
    linear = random_plant(np.random.default_rng(m), 4, m).linear
    alpha = 3.0
    P, K, residual, _ = paper_riccati(linear.A, linear.B, alpha, np.eye(4))
    optimal = solve_riccati(linear, np.eye(4), np.eye(m) / (2 * alpha))
    assert pytest.approx(optimal.P) == P
    assert pytest.approx(optimal.K / 2) == K
    assert residual < 1e-13
    assert np.linalg.eigvals(linear.A - linear.B @ K).real.max() < 0


def test_an_equation_without_a_solution_is_reported() -> None:
    with pytest.raises(StructureError, match="the Riccati equation has no stabilising solution"):
        solve_riccati(model(np.diag([1.0, -1.0]), np.array([[0.0], [1.0]])), np.eye(2), np.eye(1))
    with pytest.raises(
        StructureError, match="the discrete Riccati equation has no stabilising solution"
    ):
        solve_riccati(
            model(np.diag([1.5, 0.5]), np.array([[0.0], [1.0]])), np.eye(2), np.eye(1), 0.1
        )
