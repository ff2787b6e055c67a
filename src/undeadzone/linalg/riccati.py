"""Riccati equation (34), as printed and for control, with the related Lyapunov equations.

They give the least gain that makes A - L C as fast as required and, by duality, A - B K.
"""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.linalg.matrices import (
    Matrices,
    delta_form,
    scale_states,
    spectral_radius,
    state_response_sizes,
    symmetric_part,
)
from undeadzone.linalg.poles import slowest_growth_rate
from undeadzone.util.arrays import Array, Floats, list_numbers, require_array, require_matrix

NEWTON = 10  # iterations of Newton's method, at most


class Riccati(NamedTuple):
    """Solution of a Riccati equation.

    Attributes:
        P: the solution (n x n).
        K: the gain (m x n).
        residual: of the equation, relative to its terms.
        left: the same as it is (n x n).
    """

    P: Floats
    K: Floats
    residual: float
    left: Floats


class _Equation(NamedTuple):
    """Riccati equation: its matrices, and the step [s] if sampled."""

    A: Floats
    B: Floats
    Q: Floats
    R: Floats
    Ts: float | None


def require_weight(key: str, Q: Array, n: int, why: str = "states x states") -> Floats:
    """Return Q as a symmetric positive definite n x n matrix, or raise.

    Args:
        key: named in errors.
        Q: the matrix (a number q means q I, n numbers its diagonal).
        n: its size.
        why: meaning of the rows and columns, for the error.

    Raises:
        InputError: not numbers, not symmetric, or not positive definite.
        ShapeError: another shape.
    """
    entries = require_array(key, Q)
    if entries.ndim == 0 or entries.shape == (n,):
        entries = np.diag(np.broadcast_to(entries, n))
    weights = require_matrix(key, entries, n, n, why)
    if not np.allclose(weights, weights.T):
        raise InputError(f"{key}: must be symmetric")
    least = np.linalg.eigvalsh(weights)[0]
    if least <= 0:
        raise InputError(f"{key}: must be positive definite, its least eigenvalue is {least:.4g}")
    return weights


def solve_riccati(linear: Matrices, Q: Floats, R: Floats, Ts: float | None = None) -> Riccati:
    """Return the stabilising P of A'P + PA - P B R^-1 B'P + Q = 0 and K = R^-1 B'P.

    Sampled, P = A'PA - A'PB (R + B'PB)^-1 B'PA + Q and K = (R + B'PB)^-1 B'PA. scipy's answer is
    improved by Newton's method (Kleinman 1968, Hewer 1971) for as long as the residual falls.

    References:
        D. L. Kleinman (1968), doi:10.1109/TAC.1968.1098829
        G. A. Hewer (1971), doi:10.1109/TAC.1971.1099755

    Args:
        linear: the model, continuous or sampled (any number of inputs).
        Q: weight of the states (n x n).
        R: weight of the inputs (m x m).
        Ts: step of a sampled model [s] (None: continuous).

    Raises:
        StructureError: there is no stabilising solution.
    """
    A = np.asarray(linear.A, float)
    B = np.asarray(linear.B, float)
    Q = np.asarray(Q, float)
    R = np.atleast_2d(np.asarray(R, float))
    equation = _Equation(A, B, Q, R, Ts)
    best = _evaluate_riccati(equation, _solution(equation))
    for _ in range(NEWTON):
        closed = A - B @ best.K
        if best.residual == 0 or not slowest_growth_rate(np.linalg.eigvals(closed), Ts) < 0:
            break
        P = best.P + storage_of(closed, best.left, Ts)
        candidate = _evaluate_riccati(equation, symmetric_part(P))
        if not candidate.residual < best.residual / 2:
            break
        best = candidate
    return best


def _solution(equation: _Equation) -> Floats:
    """Return scipy's solution of a Riccati equation.

    Raises StructureError if no solution exists.
    """
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    A, B, Q, R, Ts = equation
    name = "Riccati equation" if Ts is None else "discrete Riccati equation"
    solve = solve_continuous_are if Ts is None else solve_discrete_are
    try:
        return np.asarray(solve(A, B, Q, R))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise StructureError(f"the {name} has no stabilising solution here: {error}") from None


def _evaluate_riccati(equation: _Equation, P: Floats) -> Riccati:
    """Return a matrix with its gain and residual in the equation."""
    A, B, Q, R, Ts = equation
    terms: tuple[Floats, ...]
    if Ts is None:
        K = np.linalg.solve(R, B.T @ P)
        terms = (A.T @ P, P @ A, -K.T @ R @ K, Q)
    else:
        K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        terms = (A.T @ P @ A, -P, -(A.T @ P @ B) @ K, Q)
    left = sum(terms[1:], terms[0])
    scale = max(sum(map(np.linalg.norm, terms)), 1e-300)
    return Riccati(P, K, float(np.linalg.norm(left) / scale), left)


def riccati_along(A: Floats, B: Floats, Q: Floats, R: Floats, P: Floats) -> Floats:
    """Return the gains of the sampled Riccati equation, backwards along a trajectory.

    Args:
        A, B: the model at each sample (N x n x n, N x n x m).
        Q: weight of the states (n x n).
        R: weight of the inputs (m x m).
        P: the solution after the last sample (n x n).

    Returns:
        K (N x m x n).
    """
    K = np.empty(B.swapaxes(1, 2).shape)
    for k in reversed(range(len(A))):
        gain = P @ B[k]
        K[k] = np.linalg.solve(R + B[k].T @ gain, gain.T @ A[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ K[k])
        P = symmetric_part(P)
    return K


def paper_riccati(A: Floats, B: Floats, alpha: float, Q: Floats) -> Riccati:
    """Return P of A'P + PA - 2 alpha P B B' P = -Q, (34), and K = alpha B'P.

    Args:
        A: matrix in the place of A, (A - L C as printed) (n x n).
        B: (n x m).
        alpha: weight of the quadratic term.
        Q: (n x n).

    Raises:
        StructureError: no solution is found.
    """
    linear = Matrices(A, B, np.zeros((0, len(A))))
    try:
        solution = solve_riccati(linear, Q, np.eye(B.shape[1]) / (2 * alpha))
    except StructureError as error:
        raise StructureError(str(error).replace("equation", "equation (34)", 1)) from None
    return solution._replace(K=alpha * B.T @ solution.P)


def paper_feedback(linear: Matrices, alpha: float, Q: Floats, Ts: float | None) -> Floats:
    """Return K of (34) with A, or its sampled counterpart, which tends to K as Ts -> 0.

    K = alpha B'P is half the optimal gain for R = 1 / (2 alpha). Sampled: half of
    (R + B'PB)^-1 B'PA of the discrete equation with Q Ts, R Ts.

    Args:
        linear: the model, continuous or sampled.
        alpha: weight of the quadratic term.
        Q: (n x n).
        Ts: step of a sampled model [s] (None: continuous).

    Returns:
        K (m x n).

    Raises:
        StructureError: there is no solution, or its sampled gain does not stabilise.
    """
    A, B, _ = linear
    if Ts is None:
        return paper_riccati(A, B, alpha, Q).K
    K = solve_riccati(linear, Q * Ts, np.eye(B.shape[1]) * Ts / (2 * alpha), Ts).K / 2
    radius = spectral_radius(A - B @ K)
    if radius >= 1:
        raise StructureError(
            f"controller.alpha: (34) sampled at {Ts:g} s does not stabilise (spectral radius "
            f"{radius:.4g}). Use a smaller step or poles"
        )
    return np.asarray(K)


def lyapunov_of_loop(linear: Matrices, K: Floats, Q: Floats, Ts: float | None) -> Floats:
    """Return P (n x n) of (A - BK)'P + P(A - BK) = -Q, or of its sampled form.

    Args:
        linear: the model, continuous or sampled.
        K: the gain (m x n).
        Q: (n x n).
        Ts: step of a sampled model [s] (None: continuous).

    Returns:
        P (n x n).

    Raises:
        StructureError: A - BK is not stable.
    """
    closed = linear.A - linear.B @ K
    poles = np.linalg.eigvals(closed)
    if not slowest_growth_rate(poles, Ts) < 0:
        raise StructureError(
            f"controller: A - BK is not stable, its poles are {list_numbers(poles)}"
        )
    return storage_of(closed, Q, Ts)


def storage_of(A: Floats, Q: Floats, Ts: float | None) -> Floats:
    """Return P (n x n) of A'P + PA = -Q, or of A'PA - P = -Q.

    Args:
        A: of a stable system, of one step if sampled (n x n).
        Q: how fast x'Px falls (n x n), per step if sampled.
        Ts: sample time [s] (None in continuous time).
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    if Ts is None:
        return np.asarray(solve_continuous_lyapunov(A.T, -Q))
    return np.asarray(solve_discrete_lyapunov(A.T, Q))


def fast_gain(linear: Matrices, speed: float, Ts: float | None) -> Floats:
    """Return L (n x p) that puts A - L C left of -speed / 2 (sampled: within e^(-speed Ts /
    2)).

    Args:
        linear: the model, of the sampled one Ad, Bd, C.
        speed: speed [1/s].
        Ts: sample time [s] (None in continuous time).

    Raises:
        StructureError: if the outputs hardly show some state.
    """
    A, _, C = linear
    flow = delta_form(linear, Ts).A
    # the unit of each state, so that the equations below are near 1
    unit = 1 / (speed * state_response_sizes(flow.T, C.T, speed))
    A = scale_states(A, unit)
    C = C * unit
    L = _riccati_gain_with_shift(A, C, speed, Ts)
    if not slowest_growth_rate(np.linalg.eigvals(A - L @ C), Ts) < -speed / 4:
        raise StructureError(
            f"observer.speed: {speed:.4g} 1/s cannot be reached, the outputs hardly show some "
            "state. Give a lower speed, or poles"
        )
    return unit[:, None] * L


def fast_feedback(linear: Matrices, speed: float, Ts: float | None) -> Floats:
    """Return K (m x n) that puts A - B K left of -speed / 2 (sampled: within e^(-speed Ts /
    2)).

    Args:
        linear: the model, of the sampled one Ad, Bd, C.
        speed: speed [1/s].
        Ts: sample time [s] (None in continuous time).

    Raises:
        StructureError: if the inputs hardly move some state.
    """
    try:
        return fast_gain(linear.dual, speed, Ts).T
    except StructureError:
        raise StructureError(
            f"controller.speed: {speed:.4g} 1/s cannot be reached, the inputs hardly move some "
            "state. Give a lower speed, poles or K"
        ) from None


def _riccati_gain_with_shift(A: Floats, C: Floats, speed: float, Ts: float | None) -> Floats:
    """Return the Riccati gain of A shifted right by speed / 2 (n x p), or 0 if none exists."""
    n = A.shape[0]
    p = C.shape[0]
    noise = 1e-8 * np.eye(n)
    with warnings.catch_warnings():
        # of scipy, on ill-conditioned equations: `fast_gain` judges the poles
        warnings.simplefilter("ignore")
        try:
            if Ts is None:
                shifted = Matrices((A / speed + np.eye(n) / 2).T, C.T, C)
                return speed * solve_riccati(shifted, noise, np.eye(p)).K.T
            shrink = np.exp(-speed / 2 * Ts)
            span = speed * Ts
            shifted = Matrices((A / shrink).T, C.T, C)
            return shrink * solve_riccati(shifted, noise * span, np.eye(p) / span, Ts).K.T
        except np.linalg.LinAlgError:
            return np.zeros((n, p))
