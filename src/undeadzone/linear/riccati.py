"""The Riccati equation (34), as printed and for control, and the Lyapunov equations beside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.errors import InputError, StructureError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Array, Floats, array, listed, matrix


class Riccati(NamedTuple):
    """P (n x n), the gain K (m x n), and the residual of the equation relative to its terms."""

    P: Floats
    K: Floats
    residual: float


def weight(key: str, Q: Array, n: int, why: str = "states x states") -> Floats:
    """Q as a symmetric positive definite n x n matrix; a number q means q I, n numbers its diagonal. Raises InputError, ShapeError."""
    found = array(key, Q)
    if found.ndim == 0 or found.shape == (n,):
        found = np.diag(np.broadcast_to(found, n))
    found = matrix(key, found, n, n, why)
    if not np.allclose(found, found.T):
        raise InputError(f"{key}: must be symmetric")
    if (least := np.linalg.eigvalsh(found)[0]) <= 0:
        raise InputError(f"{key}: must be positive definite, its least eigenvalue is {least:.4g}")
    return found


def riccati(linear: Matrices, Q: Floats, R: Floats, Ts: float | None = None) -> Riccati:
    """The stabilising P of A'P + PA - P B R^-1 B'P + Q = 0 and K = R^-1 B'P, for any number of inputs.

    Sampled, P = A'PA - A'PB (R + B'PB)^-1 B'PA + Q and K = (R + B'PB)^-1 B'PA. scipy's answer is improved by Newton's
    method (Kleinman 1968; Hewer 1971) for as long as the residual falls. Raises StructureError if there is none.
    """
    from scipy.linalg import solve_continuous_are, solve_discrete_are

    A, B = (np.asarray(M, float) for M in linear[:2])
    Q, R = np.asarray(Q, float), np.atleast_2d(np.asarray(R, float))
    try:
        P = solve_continuous_are(A, B, Q, R) if Ts is None else solve_discrete_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        name = "Riccati equation" if Ts is None else "discrete Riccati equation"
        raise StructureError(f"the {name} has no stabilising solution here: {error}") from None

    def judge(P: Floats) -> tuple[float, Floats, Floats]:
        """(relative residual, residual, K)."""
        if Ts is None:
            K = np.linalg.solve(R, B.T @ P)
            terms = (A.T @ P, P @ A, -K.T @ R @ K, Q)
        else:
            K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
            terms = (A.T @ P @ A, -P, -(A.T @ P @ B) @ K, Q)
        off = sum(terms[1:], terms[0])
        return (
            float(np.linalg.norm(off) / max(sum(np.linalg.norm(term) for term in terms), 1e-300)),
            off,
            K,
        )

    relative, off, K = judge(P)
    for _ in range(10):
        if relative == 0 or not _stable(np.linalg.eigvals(A - B @ K), Ts):
            break
        trial = P + _lyapunov(A - B @ K, off, Ts)
        judged = judge((trial + trial.T) / 2)
        if not judged[0] < relative / 2:
            break
        P, (relative, off, K) = (trial + trial.T) / 2, judged
    return Riccati(P, K, relative)


def riccati_along(A: Floats, B: Floats, Q: Floats, R: Floats, P: Floats) -> Floats:
    """K (N x m x n) of the sampled equation backwards along A (N x n x n), B (N x n x m), from P (n x n) after the last sample."""
    K = np.empty(B.swapaxes(1, 2).shape)
    for k in reversed(range(len(A))):
        gain = P @ B[k]
        K[k] = np.linalg.solve(R + B[k].T @ gain, gain.T @ A[k])
        P = Q + A[k].T @ P @ (A[k] - B[k] @ K[k])
        P = (P + P.T) / 2
    return K


def paper_riccati(A: Floats, B: Floats, alpha: float, Q: Floats) -> Riccati:
    """P of A'P + PA - 2 alpha P B B' P = -Q, (34), with whatever stands for A (A - L C as printed), and K = alpha B'P.

    Raises StructureError if none is found.
    """
    try:
        found = riccati(Matrices(A, B, np.zeros((0, len(A)))), Q, np.eye(B.shape[1]) / (2 * alpha))
    except StructureError as error:
        raise StructureError(str(error).replace("equation", "equation (34)", 1)) from None
    return found._replace(K=alpha * B.T @ found.P)


def feedback(linear: Matrices, alpha: float, Q: Floats, Ts: float | None) -> Floats:
    """K (m x n) of (34) with A, or its sampled counterpart, which tends to it as Ts -> 0. Raises StructureError.

    K = alpha B'P is half the optimal gain for R = 1 / (2 alpha); sampled: half of (R + B'PB)^-1 B'PA of the discrete
    equation with Q Ts, R Ts.
    """
    A, B, _ = linear
    if Ts is None:
        return paper_riccati(A, B, alpha, Q).K
    K = riccati(linear, Q * Ts, np.eye(B.shape[1]) * Ts / (2 * alpha), Ts).K / 2
    radius = float(np.abs(np.linalg.eigvals(A - B @ K)).max())
    if radius >= 1:
        raise StructureError(
            f"controller.alpha: (34) sampled at {Ts:g} s does not stabilise (spectral radius {radius:.4g}); use a smaller step or poles"
        )
    return np.asarray(K)


def lyapunov(linear: Matrices, K: Floats, Q: Floats, Ts: float | None) -> Floats:
    """P of (A - BK)'P + P(A - BK) = -Q, or of its sampled form. Raises StructureError if A - BK is not stable."""
    closed = linear.A - linear.B @ K
    poles = np.linalg.eigvals(closed)
    if not _stable(poles, Ts):
        raise StructureError(f"controller: A - BK is not stable, its poles are {listed(poles)}")
    return _lyapunov(closed, Q, Ts)


def _stable(poles: np.ndarray, Ts: float | None) -> bool:
    return bool((poles.real.max() < 0) if Ts is None else (np.abs(poles).max() < 1))


def _lyapunov(A: Floats, Q: Floats, Ts: float | None) -> Floats:
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    return np.asarray(
        solve_continuous_lyapunov(A.T, -Q) if Ts is None else solve_discrete_lyapunov(A.T, Q)
    )
