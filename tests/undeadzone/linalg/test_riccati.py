"""Riccati and Lyapunov equations by their residuals; the paper's own numbers.

Sampled gains tend to continuous ones.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes import PAPER_PLANT, random_plant, seeds, slopes
from undeadzone.errors import StructureError
from undeadzone.linalg import riccati
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import (
    _Equation,
    _evaluate_riccati,
    lyapunov_of_loop,
    paper_feedback,
    paper_riccati,
    require_weight,
    solve_riccati,
)


@given(seeds, st.integers(1, 5), st.integers(1, 2), st.floats(0.1, 100))
def test_equation_34_holds_and_its_gain_stabilises(seed: int, n: int, m: int, alpha: float) -> None:
    rng = np.random.default_rng(seed)
    A, B, _ = random_plant(rng, n, m, stable=False).linear
    root = rng.normal(size=(n, n))
    Q = root @ root.T + np.eye(n)
    P, K, residual, _ = paper_riccati(A, B, alpha, Q)
    left = A.T @ P + P @ A - 2 * alpha * P @ B @ B.T @ P
    assert np.linalg.norm(left + Q) < 1e-6 * max(np.linalg.norm(Q), np.linalg.norm(A.T @ P))
    assert residual < 1e-6
    assert np.linalg.eigvalsh(P)[0] > 0
    assert pytest.approx(alpha * B.T @ P) == K
    assert np.linalg.eigvals(A - B @ K).real.max() < 0


@pytest.mark.parametrize("Ts", [None, 0.1])
def test_a_candidate_shows_what_it_leaves_of_the_equation(Ts: float | None) -> None:
    A, B, C = random_plant(np.random.default_rng(2), 3, 2).linear
    linear = Matrices(A, B, C) if Ts is None else zoh(Matrices(A, B, C), Ts)
    Q, R = np.eye(3), np.diag([1.0, 2.0])
    solution = solve_riccati(linear, Q, R, Ts)
    equation = _Equation(linear.A, linear.B, Q, R, Ts)
    exact, wrong = (
        _evaluate_riccati(equation, solution.P),
        _evaluate_riccati(equation, 2 * solution.P),
    )
    assert exact.residual == solution.residual < 1e-12
    assert wrong.residual > 0.05
    assert np.linalg.norm(wrong.left) > 1e6 * np.linalg.norm(exact.left)
    assert pytest.approx(exact.K) == solution.K


def test_the_papers_equation_destabilises() -> None:
    """(34) as printed, with A - L C for (39) and L = (12, 15), alpha = 10.

    Then K = (-1.08, 1.22), and A - B K grows at 0.024.
    """
    A, B, C = PAPER_PLANT.linear
    K = paper_riccati(A - np.array([[12.0], [15.0]]) @ C, B, 10.0, np.eye(2)).K
    assert K.ravel() == pytest.approx([-1.08, 1.22], abs=0.005)
    assert np.linalg.eigvals(A - B @ K).real.max() == pytest.approx(0.024, abs=0.0005)


def test_a_missing_stabilising_solution_is_reported() -> None:
    with pytest.raises(StructureError, match=r"\(34\) has no stabilising solution"):
        paper_riccati(np.diag([1.0, -1.0]), np.array([[0.0], [1.0]]), 1.0, np.eye(2))
    unmoved = Matrices(np.diag([1.5, 0.5]), np.array([[0.0], [1.0]]), np.eye(2))
    words = "discrete Riccati equation has no stabilising solution"
    with pytest.raises(StructureError, match=words):
        paper_feedback(unmoved, 1.0, np.eye(2), 0.1)


def test_sampled_gain_tends_to_the_continuous_one_in_first_order() -> None:
    exact = paper_feedback(PAPER_PLANT.linear, 10.0, np.eye(2), None)
    steps = [0.02, 0.01, 0.005]
    errors = []
    for Ts in steps:
        sampled = paper_feedback(zoh(PAPER_PLANT.linear, Ts), 10.0, np.eye(2), Ts)
        errors.append(np.abs(sampled - exact).max())
    assert slopes(steps, errors) == pytest.approx(1.0, abs=0.1)


def test_half_the_sampled_optimal_gain_may_not_stabilise() -> None:
    fast = Matrices(4.0 * np.eye(1), np.eye(1), np.eye(1))
    words = r"controller.alpha: .* does not stabilise .spectral radius"
    with pytest.raises(StructureError, match=words):
        paper_feedback(fast, 1000.0, np.eye(1), 1.0)


@given(seeds, st.integers(1, 4))
def test_lyapunov_equations_hold(seed: int, n: int) -> None:
    linear = random_plant(np.random.default_rng(seed), n).linear
    K, Q = np.zeros((1, n)), np.eye(n)
    P = lyapunov_of_loop(linear, K, Q, None)
    assert pytest.approx(-Q, abs=1e-7) == linear.A.T @ P + P @ linear.A
    sampled = zoh(linear, 0.1)
    P = lyapunov_of_loop(sampled, K, Q, 0.1)
    assert pytest.approx(-Q, abs=1e-7) == sampled.A.T @ P @ sampled.A - P


def test_lyapunov_needs_a_stable_loop() -> None:
    with pytest.raises(StructureError, match="controller: A - BK is not stable, its poles are"):
        lyapunov_of_loop(PAPER_PLANT.linear, np.array([[-9.0, 0.0]]), np.eye(2), None)


def test_weight_of_a_number_is_a_multiple_of_the_identity() -> None:
    assert require_weight("Q", 3.0, 2).tolist() == [[3, 0], [0, 3]]
    assert require_weight("Q", [[2, 1], [1, 2]], 2).tolist() == [[2, 1], [1, 2]]


def test_newton_refines_a_riccati_solution() -> None:
    """States in units from 1e-4 to 1e4: Schur's method alone leaves 8e-7."""
    rng = np.random.default_rng(8)
    scale = 10 ** rng.uniform(-4, 4, 5)
    A = rng.normal(size=(5, 5)) * scale[:, None] / scale
    B = rng.normal(size=(5, 1)) * scale[:, None]
    Q = np.diag(10 ** rng.uniform(-3, 3, 5))
    assert solve_riccati(Matrices(A, B, np.zeros((0, 5))), Q, np.array([[1e-6]])).residual < 1e-8


def test_a_refinement_that_does_not_halve_the_residual_is_rejected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Newton's step is bent such that the residual falls to 0.8 of what it was."""
    A, B = np.array([[-1.0]]), np.array([[1.0]])
    exact = np.sqrt(2) - 1
    monkeypatch.setattr(riccati, "_solution", lambda equation: np.array([[exact + 1e-3]]))
    monkeypatch.setattr(riccati, "storage_of", lambda *_: np.array([[-2e-4]]))
    found = riccati.solve_riccati(Matrices(A, B, np.eye(1)), np.eye(1), np.eye(1))
    assert found.P[0, 0] == exact + 1e-3
    monkeypatch.setattr(riccati, "storage_of", lambda *_: np.array([[-6e-4]]))
    found = riccati.solve_riccati(Matrices(A, B, np.eye(1)), np.eye(1), np.eye(1))
    assert found.P[0, 0] == exact + 1e-3 - 6e-4


def test_one_stable_pole_does_not_make_the_sampled_gain_of_34_stable() -> None:
    plant = Matrices(np.diag([3.0, 0.1]), np.array([[1.0], [1.0]]), np.eye(2))
    with pytest.raises(StructureError, match="does not stabilise"):
        riccati.paper_feedback(plant, 1.0, np.eye(2), 1.0)
