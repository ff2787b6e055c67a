"""The certificate: exact where theory is, provable in rational arithmetic, scale-free, honest."""

from __future__ import annotations

import itertools
import re
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from benchmarks.design.random_designs import random_design, random_matrices
from scipy.linalg import block_diag, expm

from scenes import PAPER_PLANT, random_plant
from undeadzone.analysis.certificate import weights
from undeadzone.analysis.certificate.passivity import (
    Certificate,
    certify,
    certify_dynamics,
    is_defective,
    passive_gain,
    recheck_proof,
)
from undeadzone.analysis.certificate.weights import margin_of_weights
from undeadzone.analysis.dissipation import (
    Inequality,
    _least_eigenvalue_and_rounding,
    _lyapunov_storage,
    check_inequality,
)
from undeadzone.analysis.error_dynamics import Dynamics, adaptation_matrix, build_error_dynamics
from undeadzone.errors import InputError, ShapeError, StructureError
from undeadzone.linalg.hold import zoh
from undeadzone.linalg.matrices import Matrices, delta_form
from undeadzone.util.arrays import Floats
from undeadzone_design.certificate.nearest import decay_limit, nearest_certified_gains

PAPER = PAPER_PLANT.linear
TIMES = [None, 1e-4, 1e-3, 1e-2, 0.1, 1.0]


def column(*L: float) -> Floats:
    return np.array(L)[:, None]


def sampled(linear: Matrices, Ts: float | None) -> Matrices:
    return linear if Ts is None else zoh(linear, Ts)


def gridded(linear: Matrices, L: Floats, Ts: float | None) -> float:
    """min Re G on a grid: the textbook's way, in delta form."""
    if Ts is None:
        s = 1j * np.concatenate([[0.0], np.geomspace(1e-4, 1e5, 20001)])
    else:
        s = np.expm1(1j * np.concatenate([[0.0], np.geomspace(1e-6, np.pi, 20001)])) / Ts
    n = len(L)
    pencils = s[:, None, None] * np.eye(n) - delta_form(linear, Ts).A
    G = linear.C @ np.linalg.solve(pencils, L[None].astype(complex))
    return float(np.linalg.eigvalsh((G + G.conj().transpose(0, 2, 1)) / 2)[:, 0].min())


def condition(L: Floats) -> tuple[bool, float]:
    """Whether 1 + G is positive real for (39), and how far L is from the edge, relatively.

    It is iff b0 > 0 and 2 b1 > (sqrt(b0) - 1)^2.
    """
    b1, b0 = 2 + L[0, 0], 1 + 2 * L[0, 0] + L[1, 0]
    if b0 <= 0:
        return False, abs(b0)
    gap = 2 * b1 - (np.sqrt(b0) - 1) ** 2
    return bool(gap > 0), min(abs(gap) / (1 + abs(b1)), b0)


def test_certified_exactly_where_theory_says_for_two_thousand_gains() -> None:
    rng = np.random.default_rng(0)
    wrong = [0, 0]
    for k in range(2_000):
        L = rng.normal(0, 10 ** rng.uniform(-1, 2), (2, 1))
        expected, distance = condition(L)
        if distance < 1e-7:
            continue
        wrong[0] += (
            margin_of_weights(build_error_dynamics(PAPER, L, np.ones(1), None), np.ones(1))[0] > 0
        ) != expected
        if k % 25 == 0 and distance > 1e-4:
            wrong[1] += certify(PAPER, L, np.ones(1)).certified != expected
    assert wrong == [0, 0]


def test_the_papers_gains_miss_it_narrowly() -> None:
    """(12, 15): Re(1 + G) = (u^2 - 13 u + 40)/(1 + u)^2 with u = w^2, least -1/24 at u = 6.2."""
    found = certify(PAPER, column(12, 15), np.array([2.0]))
    assert not found.certified
    assert found.margin == pytest.approx(-1 / 24, abs=1e-9)
    assert found.frequency == pytest.approx(np.sqrt(6.2), abs=1e-5)
    assert "not positive real" in found.reason
    assert "2.49 rad/s" in found.reason


@pytest.mark.parametrize(
    ("L", "gamma", "least"),
    [
        ((1, 1.5), 10.0, 0.8875),
        ((2, 3), 10.0, 0.775),
        ((0, 0), 10.0, 1.0),
        ((-0.8733, 0.7567), 7.78, 0.0101),
    ],
)
def test_gains_of_the_table_are_certified(
    L: tuple[float, float], gamma: float, least: float
) -> None:
    found = certify(PAPER, column(*L), np.array([gamma]))
    assert found.certified
    assert found.margin == pytest.approx(least, abs=1e-9)
    assert found.reason == ""
    assert found.check.lmi < -found.check.rounding


@pytest.mark.parametrize("Ts", TIMES[1:])
def test_sampled_the_adaptation_step_is_limited_exactly(Ts: float) -> None:
    """Feasible iff g < 2 (1 + min Re C (zI - Ad)^-1 Ld), from 0.1 ms to 1 s."""
    linear = zoh(PAPER, Ts)
    for L in (column(0.1, 0.2), column(-0.3, 0.1), column(0.4, -0.3)):
        limit = 2 * (1 + gridded(linear, L, Ts))
        assert certify(linear, L, np.array([(1 - 1e-4) * limit / Ts]), Ts).certified
        above = certify(linear, L, np.array([(1 + 1e-4) * limit / Ts]), Ts)
        assert not above.certified
        assert above.margin == pytest.approx(-1e-4 * limit / 2, rel=1e-3)


@pytest.mark.parametrize("seed", range(12))
def test_worst_frequency_is_never_above_a_dense_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 9)), int(rng.integers(1, 4))
    Ts = TIMES[seed % len(TIMES)]
    linear, L = sampled(random_matrices(rng, n, p, spread=3.0), Ts), rng.normal(size=(n, p))
    least, w = margin_of_weights(build_error_dynamics(linear, L, np.zeros(p), Ts), np.ones(p))
    grid = 1 + gridded(linear, L, Ts)
    assert least <= grid + 1e-9 * max(1, abs(grid))
    assert grid - least < 1e-3 * max(1, abs(grid))
    G = weights.frequency_response(delta_form(linear, Ts).A, linear.C, L, np.eye(p), Ts)
    at = w if Ts is None else 2 / Ts * np.tan(w * Ts / 2)
    there = np.linalg.eigvalsh(G.hermitian_part(np.array([at]))[0])[0]
    assert there == pytest.approx(least, rel=1e-6, abs=1e-9)


def exact(M: Any) -> Any:
    """A matrix of rational numbers, the same to the last bit."""
    return np.array([[Fraction(float(x)) for x in row] for row in np.atleast_2d(M)], dtype=object)


def positive_definite(M: Any) -> bool:
    """By the pivots of Gaussian elimination, without rounding."""
    M = M.copy()
    for k in range(len(M)):
        if M[k, k] <= 0:
            return False
        for i in range(k + 1, len(M)):
            M[i] = M[i] - M[i, k] / M[k, k] * M[k]
    return True


def proved_exactly(found: Certificate, linear: Matrices) -> bool:
    """V+ - V < 0 or V' < 0 in (x~, e), from the plain (not the delta) form, in rational numbers."""
    errors, Ts = found.dynamics, found.dynamics.Ts
    A, C, L = exact(linear.A), exact(errors.C), exact(errors.L)
    P, W = exact(found.P), exact(np.diag(found.W))
    n, p = errors.L.shape
    if Ts is None:
        PA, cross = P @ A, C.T @ W - P @ L
        M = np.block([[PA + PA.T, cross], [cross.T, -2 * W]])
    else:
        step = Fraction(Ts)
        F = np.hstack([A, -step * L])
        M = F.T @ P @ F / step
        M[:n, :n] -= P / step
        M[:n, n:] += C.T @ W
        M[n:, :n] += W @ C
        gamma = exact(np.diag(np.diag(errors.gamma).reshape(p, 2).max(axis=1)))
        M[n:, n:] += W @ (step * gamma - 2 * exact(np.eye(p)))
    return positive_definite(P) and positive_definite(-M)


@pytest.mark.parametrize("seed", range(12))
def test_proofs_hold_in_rational_arithmetic(seed: int) -> None:
    """The numbers P, W prove that V falls for the numbers A, C, L, gamma.

    No floating point, no delta form, no solver.
    """
    rng = np.random.default_rng(seed)
    n = 1 + seed % 4
    linear, L, gamma, Ts = random_design(rng, n, min(n, 1 + seed % 3))
    found = certify(linear, L, np.diag(adaptation_matrix(gamma, len(linear.C))).reshape(-1, 2), Ts)
    assert found.certified
    assert proved_exactly(found, linear)
    assert not proved_exactly(found._replace(V=found.V._replace(P=100 * found.P)), linear)


@pytest.mark.parametrize("seed", range(6))
def test_margin_of_several_outputs_is_the_best_over_weights(seed: int) -> None:
    rng = np.random.default_rng(seed)
    linear, L, _, Ts = random_design(rng, 5, 3)
    found = certify(linear, 3 * L, np.ones(3), Ts)
    at, w = margin_of_weights(found.dynamics, found.W)
    assert at == pytest.approx(found.margin, abs=1e-6 * max(1, abs(at)))
    assert found.frequency == pytest.approx(w, rel=1e-3, abs=1e-3)
    for _ in range(100):
        other = found.W * np.exp(rng.normal(size=3) * 10 ** rng.uniform(-2, 0.5))
        assert margin_of_weights(found.dynamics, other)[0] <= found.margin + 1e-5 * max(
            1, abs(found.margin)
        )


@pytest.mark.parametrize("Ts", [None, 0.01])
@pytest.mark.parametrize("slow", [7e-9, 1e-4, 0.3])
def test_weights_are_found_however_slow_a_pole_is(slow: float, Ts: float | None) -> None:
    """Equal weights fail, others certify."""
    model = Matrices(np.diag([-1.0, -slow]), np.ones((2, 1)), np.array([[1.4, 0.7], [-0.5, 1.4]]))
    L = np.array([[0.1, 1.5], [0.0, slow]])
    linear = model if Ts is None else zoh(model, Ts)
    found = certify(linear, L, np.ones(2), Ts)
    assert certify_dynamics(found.dynamics, np.ones(2)).margin < 0
    assert found.certified
    ratios = 10 ** np.linspace(-3, 3, 601)
    tried = [margin_of_weights(found.dynamics, np.array([1.0, ratio]))[0] for ratio in ratios]
    assert found.margin >= max(tried) - 1e-6


def test_decoupled_outputs_have_the_least_of_their_margins() -> None:
    one, two = certify(PAPER, column(4, 6), np.ones(1)), certify(PAPER, column(1, 1.5), np.ones(1))
    both = Matrices(
        np.kron(np.eye(2), PAPER.A), np.kron(np.eye(2), PAPER.B), np.kron(np.eye(2), PAPER.C)
    )
    found = certify(
        both,
        np.block([[column(4, 6), np.zeros((2, 1))], [np.zeros((2, 1)), column(1, 1.5)]]),
        np.ones(2),
    )
    assert found.certified
    assert found.margin == pytest.approx(min(one.margin, two.margin), abs=1e-8)


@pytest.mark.parametrize("Ts", [None, 1e-3, 0.1])
def test_units_do_not_matter(Ts: float | None) -> None:
    """States in other units by 1e-4 to 1e5, outputs by 1e3: same verdict and margin.

    In continuous time the unit of time may differ by 1e4, too.
    """
    rng = np.random.default_rng(4)
    linear, L = sampled(random_matrices(rng, 4, 2), Ts), rng.normal(size=(4, 2)) * 0.02
    gamma = np.array([0.5, 0.2])
    plain = certify(linear, L, gamma, Ts)
    x, y = np.array([1e-4, 1.0, 1e5, 30.0]), np.array([1e3, 1e-2])
    other = certify(
        Matrices(linear.A * x / x[:, None], linear.B, linear.C * x / y[:, None]),
        L * y / x[:, None],
        gamma,
        Ts,
    )
    assert plain.certified
    assert other.certified
    assert other.margin == pytest.approx(plain.margin, abs=1e-6)
    if Ts is None:
        fast = certify(Matrices(1e4 * linear.A, linear.B, linear.C), 1e4 * L, 1e4 * gamma)
        assert fast.certified
        assert fast.margin == pytest.approx(plain.margin, abs=1e-6)
        assert fast.frequency == pytest.approx(1e4 * (plain.frequency or 0), rel=1e-3)


def test_sampled_tends_to_continuous() -> None:
    L, gamma = column(1, 1.5), np.array([10.0])
    limit = certify(PAPER, L, gamma)
    off = []
    for Ts in (1e-2, 1e-3, 1e-4):
        off.append(abs(certify(zoh(PAPER, Ts), L, gamma, Ts).margin - limit.margin))
    assert off[0] > off[1] > off[2]
    assert off[1] / off[2] == pytest.approx(10, rel=0.05)


def test_stiff_plants_are_proved() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        linear, L = random_matrices(rng, 4, 1, spread=4.0), rng.normal(size=(4, 1))
        least, _ = margin_of_weights(build_error_dynamics(linear, L, np.zeros(1), None), np.ones(1))
        found = certify(linear, L * 0.9 / max(1 - least, 1e-3), np.ones(1))
        assert found.certified


def test_gamma_may_differ_right_and_left_and_be_full() -> None:
    assert adaptation_matrix(np.array(3.0), 1).tolist() == [[3, 0], [0, 3]]
    assert np.diag(adaptation_matrix(np.array([1.0, 2.0]), 2)).tolist() == [1, 1, 2, 2]
    assert np.diag(adaptation_matrix(np.array([[1.0, 2.0], [3.0, 4.0]]), 2)).tolist() == [
        1,
        2,
        3,
        4,
    ]
    full = np.array([[2.0, 1.0], [1.0, 3.0]])
    assert adaptation_matrix(full, 1).tolist() == full.tolist()
    linear, Ts = zoh(PAPER, 0.1), 0.1
    right, left = (
        certify(linear, column(1, 1.5), np.array([pair]), Ts) for pair in ([6.0, 1.0], [1.0, 6.0])
    )
    assert right.certified
    assert right.margin == pytest.approx(left.margin)
    assert right.margin == pytest.approx(
        certify(linear, column(1, 1.5), np.array([6.0]), Ts).margin
    )
    assert certify(linear, column(1, 1.5), full, Ts).certified


def test_outputs_that_gamma_couples_share_a_weight() -> None:
    linear = random_matrices(np.random.default_rng(2), 4, 2)
    gamma = np.eye(4) + 0.3
    found = certify(linear, passive_gain(linear, None), gamma)
    assert found.certified
    assert found.W[0] == found.W[1]
    assert np.allclose(found.V.R, found.V.R.T)
    assert not recheck_proof(found.dynamics, found.P, found.W * np.array([1.0, 1.0 + 1e-6])).proved


@pytest.mark.parametrize(
    ("gamma", "error", "message"),
    [
        (np.array([-1.0]), InputError, "gamma: must not be negative, found -1"),
        (np.array([1.0, 2.0]), ShapeError, "gamma: expected 1 number"),
        (
            np.array([[1.0, 2.0], [2.0, 1.0]]),
            InputError,
            "gamma: a full matrix must be symmetric and positive definite",
        ),
    ],
)
def test_impossible_gamma_is_refused(gamma: Floats, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        certify(PAPER, column(1, 1), gamma)


def test_gains_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(
        ShapeError, match=r"L: expected a 2 x 1 matrix \(states x outputs\), found 1 x 2"
    ):
        certify(PAPER, np.array([[1.0, 1.0]]), np.ones(1))


def test_recheck_trusts_nobody() -> None:
    found = certify(PAPER, column(1, 1.5), np.array([10.0]))
    P, W, errors = found.P, found.W, found.dynamics
    assert recheck_proof(errors, P, W) == found.check
    assert recheck_proof(errors, P * 3, W * 3).proved
    assert not recheck_proof(errors, -P, W).proved
    assert not recheck_proof(errors, P, -W).proved
    assert not recheck_proof(errors, P * np.nan, W).proved
    assert not recheck_proof(errors, P + np.diag([0, 50.0]), W).proved
    assert not recheck_proof(errors, P, 30 * W).proved
    assert not recheck_proof(errors._replace(L=column(12, 15)), P, W).proved
    assert not recheck_proof(errors._replace(A=(-PAPER.A,)), P, W).proved
    edge = errors._replace(A=(np.array([[-1.0]]),), C=np.ones((1, 1)), L=np.ones((1, 1)))
    assert recheck_proof(edge, np.eye(1), np.ones(1)).proved
    assert not recheck_proof(
        edge._replace(A=(np.array([[-1e-17]]),), L=column(1 + 2e-8)), np.eye(1), np.ones(1)
    ).proved


@pytest.mark.parametrize("Ts", [None, 1e-3])
def test_a_p_that_is_not_symmetric_proves_nothing(Ts: float | None) -> None:
    # x'Px holds the symmetric part alone; PA + A'P' < 0 of I + J although the spiral is unstable.
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    spiral = Matrices(0.1 * np.eye(2) + turn, column(0, 1), np.array([[1.0, 0.0]]))
    if Ts is not None:
        spiral = spiral._replace(A=expm(Ts * spiral.A))
    errors = build_error_dynamics(spiral, 1e-3 * column(1, 1), np.array([1e-3]), Ts)
    assert not recheck_proof(errors, np.eye(2) + turn, np.array([1e-2])).proved
    for share in (1.0, 1e-3, 1e-8):
        assert not recheck_proof(errors, np.eye(2) + share * turn, np.array([1e-2])).proved
    stable = certify(PAPER, column(1, 1.5), np.array([10.0]))
    assert not recheck_proof(stable.dynamics, stable.P + 1e-9 * turn, stable.W).proved


@pytest.mark.parametrize(
    ("P", "W"),
    [(np.eye(3), np.ones(1)), (np.eye(2), np.ones(2)), (np.eye(2), np.array([np.inf]))],
)
def test_a_proof_of_the_wrong_shape_or_size_proves_nothing(P: Floats, W: Floats) -> None:
    assert not recheck_proof(
        build_error_dynamics(PAPER, column(1, 1.5), np.ones(1), None), P, W
    ).proved


def test_a_full_gamma_that_is_a_little_asymmetric_is_refused() -> None:
    full = np.array([[1.0, 0.3], [0.3 + 1e-7, 1.0]])
    with pytest.raises(InputError, match="gamma: a full matrix must be symmetric"):
        certify(PAPER, column(1, 1), full)


IMPOSSIBLE: list[tuple[Any, str]] = [
    ([[0.5]], "unstable"),
    ([[0.0, 1.0], [1.0, 0.0]], "unstable"),
    ([[0.0]], "an integrator.* only their sum"),
    ([[0.0, 1.0], [0.0, -1.0]], "an integrator"),
    ([[0.0, 1.0], [-4.0, 0.0]], "an undamped mode"),
    ([[0.0, 1.0], [0.0, 0.0]], "chain of integrators"),
    (np.eye(4, k=1), "chain of integrators"),
]


@pytest.mark.parametrize("Ts", [None, 1e-3, 0.1])
@pytest.mark.parametrize(("A", "reason"), IMPOSSIBLE)
def test_marginal_and_unstable_models_get_an_honest_no(
    A: Any, reason: str, Ts: float | None
) -> None:
    A = np.array(A)
    n = len(A)
    linear = sampled(Matrices(A, np.eye(n)[:, -1:], np.eye(n)[:1]), Ts)
    found = certify(linear, np.ones((n, 1)), np.ones(1), Ts)
    assert not found.certified
    assert found.margin == -np.inf
    assert re.search(reason, found.reason)
    assert not found.check.proved
    with pytest.raises(StructureError, match=r"observer\.L: no gains can be certified"):
        nearest_certified_gains(linear, np.ones((n, 1)), np.ones(1), Ts)


@pytest.mark.parametrize("Ts", TIMES)
@pytest.mark.parametrize("seed", range(4))
def test_passive_gain_is_certified_for_every_stable_model(seed: int, Ts: float | None) -> None:
    rng = np.random.default_rng(seed)
    linear = sampled(random_plant(rng, 1 + seed, p=1 + seed % 2).linear, Ts)
    found = certify(linear, passive_gain(linear, Ts), np.full(1 + seed % 2, 0.1), Ts)
    assert found.certified or (Ts is not None and found.margin <= 0)
    assert Ts is not None or found.margin == pytest.approx(1, abs=1e-6)


def test_nearest_gains_to_the_papers() -> None:
    found = nearest_certified_gains(PAPER, column(12, 15), np.array([2.0]))
    assert found.certificate.certified
    assert found.certificate.margin == pytest.approx(0.01, abs=2e-5)
    assert found.certificate.dynamics.L.ravel() == pytest.approx([12.185, 14.552], abs=2e-3)
    assert found.distance == pytest.approx(0.0049, abs=1e-4)


@pytest.mark.parametrize("seed", range(8))
def test_nothing_certified_is_nearer(seed: int) -> None:
    """Random certified gains are all farther away in the metric of G."""
    rng = np.random.default_rng(seed)
    Ts = TIMES[seed % len(TIMES)]
    linear = sampled(random_matrices(rng, 3, 1), Ts)
    L, gamma = rng.normal(size=(3, 1)) * 20, np.array([0.1 / (Ts or 1)])
    found = nearest_certified_gains(linear, L, gamma, Ts)
    assert found.certificate.margin >= 0.01 * (1 - 1e-6)

    def size(change: Floats) -> float:
        """Energy of the impulse response of C (s - A)^-1 change, summed over eigenvalues."""
        poles, V = np.linalg.eig(delta_form(linear, Ts).A)
        residues = (linear.C @ V).ravel() * np.linalg.solve(V, change).ravel()
        overlap = poles[:, None] + poles.conj() + (Ts or 0) * poles[:, None] * poles.conj()
        return float(np.sqrt(np.real(-(residues[:, None] * residues.conj() / overlap).sum())))

    best = size(found.certificate.dynamics.L - L)
    assert found.distance == pytest.approx(best / size(L) if best > 0 else 0.0, rel=1e-3, abs=1e-9)
    errors = build_error_dynamics(linear, L, gamma, Ts)
    for _ in range(300):
        other = found.certificate.dynamics.L + rng.normal(size=(3, 1)) * 10 ** rng.uniform(-3, 1)
        if margin_of_weights(errors._replace(L=other), np.ones(1))[0] >= 0.01 * (1 + 1e-3):
            assert size(other - L) >= best * (1 - 1e-3)


def test_nearest_keeps_what_is_certified_and_serves_several_outputs() -> None:
    nearest = nearest_certified_gains(PAPER, column(1, 1.5), np.array([10.0]))
    assert nearest.distance == 0
    assert nearest.certificate.dynamics.L.tolist() == [[1.0], [1.5]]
    slower = nearest_certified_gains(zoh(PAPER, 0.01), column(1, 1.5), np.array([500.0]), 0.01)
    assert slower.certificate.dynamics.gamma[0, 0] == pytest.approx(100)
    rng = np.random.default_rng(0)
    linear, L = random_matrices(rng, 5, 3), rng.normal(size=(5, 3)) * 20
    found = nearest_certified_gains(linear, L, np.ones(3))
    assert found.certificate.certified
    assert found.certificate.margin >= 0.01 * (1 - 1e-6)
    assert 0 < found.distance < 1


@pytest.mark.parametrize("Ts", [None, 1e-3, 1e-2, 0.1])
def test_a_common_p_caps_the_decay_rate_at_two(Ts: float | None) -> None:
    assert decay_limit(sampled(PAPER, Ts), Ts) == pytest.approx(2.0, abs=1e-3)


def test_a_first_order_plant_has_no_cap() -> None:
    assert decay_limit(Matrices(np.array([[-1.0]]), np.ones((1, 1)), np.ones((1, 1)))) == np.inf


def test_one_v_for_several_vertices() -> None:
    """A common P for stiffness and damping within 50 %.

    None where 95 % is asked, or where a vertex is unstable.
    """

    def vertices(spread: float) -> Dynamics:
        corners = []
        for a, b in itertools.product((-1, 1), repeat=2):
            corners.append(np.array([[0, 1], [-(1 + a * spread), -2 * (1 + b * spread)]]))
        return build_error_dynamics(PAPER, column(1, 1.5), np.ones(1), None)._replace(
            A=tuple(corners)
        )

    found = certify_dynamics(vertices(0.5))
    assert found.certified
    assert found.frequency is None
    for A in found.dynamics.A:
        assert recheck_proof(found.dynamics._replace(A=(A,)), found.P, found.W).proved
        assert (
            margin_of_weights(found.dynamics._replace(A=(A,)), np.ones(1))[0] >= found.margin - 1e-6
        )
    assert "share no V" in certify_dynamics(vertices(0.95)).reason
    assert "unstable (vertex 0)" in certify_dynamics(vertices(1.05)).reason


@pytest.mark.parametrize("Ts", [None, 0.05])
def test_an_inequality_in_other_coordinates_is_congruent(Ts: float | None) -> None:
    """x = T xi, P = T^-T P_xi T^-1: the matrices have the same signs, and T'MT is the new M."""
    rng = np.random.default_rng(0)
    linear = random_matrices(rng, 3, 2)
    L = rng.normal(size=(3, 2))
    plain = build_error_dynamics(sampled(linear, Ts), L, np.full(2, 0.5), Ts).inequality(np.ones(2))
    T, P = rng.normal(size=(3, 3)), np.eye(3)
    other = plain.transform_coordinates(T, np.linalg.inv(T))
    for M, M_xi in zip(plain.lmi_matrices(P), other.lmi_matrices(T.T @ P @ T), strict=True):
        parts = [T, np.eye(2)] if Ts is None else [T, np.eye(2), T]
        both = block_diag(*parts)
        assert M_xi == pytest.approx(both.T @ M @ both, abs=1e-9)


def test_marginally_stable_models_are_distinguished_from_those_that_diverge() -> None:
    undamped = np.array([[0.0, 1.0], [-4.0, 0.0]])
    chain = np.array([[0.0, 1.0], [0.0, 0.0]])
    assert not is_defective(undamped, None)
    assert not is_defective(np.zeros((2, 2)), None)
    assert is_defective(chain, None)
    assert is_defective(np.block([[undamped, np.eye(2)], [np.zeros((2, 2)), undamped]]), None)
    assert is_defective(delta_form(zoh(Matrices(chain, np.eye(2), np.eye(2)), 0.1), 0.1).A, 0.1)


@pytest.mark.parametrize("Ts", [0.5, 2.0])
def test_the_start_of_the_search_proves_a_sampled_plant(Ts: float) -> None:
    """Poles near -1, where Tustin's rule with a wrong sign ends in another P."""
    F = np.array([[-0.9, 3.0], [0.0, -0.8]])
    P = _lyapunov_storage((F - np.eye(2)) / Ts, Ts)
    assert np.linalg.eigvalsh(P).min() > 0
    assert np.linalg.eigvalsh(F.T @ P @ F - P).max() < 0


@pytest.mark.parametrize("Ts", [None, 0.1, 2.0])
@pytest.mark.parametrize("chain", [True, False])
def test_a_chain_of_integrators_is_defective_beside_any_other_pole(
    Ts: float | None, chain: bool
) -> None:
    A = np.diag([0.0, 0.0, -0.3])
    A[0, 1] = float(chain)
    assert is_defective(A, Ts) is chain
    if Ts is not None:  # a pole at z = -1 of two states, which a sign would take for one at z = 3
        flip = np.array([[-2.0, float(chain)], [0.0, -2.0]]) / Ts
        assert is_defective(flip, Ts) is chain


def test_the_margin_that_a_check_shows_is_that_of_the_worst_matrix() -> None:
    """Two supplies, -1 and -0.1 off the diagonal: eigenvalues -1 + 0.9 and -1 + 0.1."""
    A = (np.array([[-1.0, 0.0], [0.0, -1.0]]),)
    supplies = tuple(2 * np.array([[0.0, c], [c, 0.0]]) for c in (0.9, 0.1))
    sizes = tuple(np.abs(supply) for supply in supplies)
    proof = check_inequality(Inequality(A, np.zeros((2, 0)), supplies, sizes, None, 0.0), np.eye(2))
    assert proof.proved
    assert proof.lmi == pytest.approx(-0.1, rel=1e-12)


def test_the_bound_on_rounding_grows_with_what_is_summed() -> None:
    bounds = [
        _least_eigenvalue_and_rounding(np.eye(3), size * np.ones((3, 3)))[1]
        for size in (1.0, 100.0, 1000.0)
    ]
    assert bounds[0] > 3 * np.finfo(float).eps
    assert bounds[2] > 5 * bounds[1] > 25 * bounds[0]
