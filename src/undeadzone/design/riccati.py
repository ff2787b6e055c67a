"""The Riccati equation (34), as printed and for control, and the Lyapunov equations beside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import linalg

from undeadzone.arrays import Array, Floats, array, matrix
from undeadzone.errors import InputError, StructureError
from undeadzone.plant import Matrices


class Riccati(NamedTuple):
    """P (n x n), K = alpha B'P (m x n), and the relative residual of the equation."""

    P: Floats
    K: Floats
    residual: float


def weight(key: str, Q: Array, n: int) -> Floats:
    """Q as a symmetric positive definite n x n matrix; a number q means q I. Raises InputError, ShapeError."""
    found = array(key, Q)
    found = float(found) * np.eye(n) if found.ndim == 0 else matrix(key, found, n, n, "states x states")
    if not np.allclose(found, found.T) or np.linalg.eigvalsh(found)[0] <= 0:
        raise InputError(f"{key}: must be symmetric and positive definite, found eigenvalues {np.linalg.eigvals(found).round(6).tolist()}")
    return found


def paper_riccati(A: Floats, B: Floats, alpha: float, Q: Floats) -> Riccati:
    """P of A'P + PA - 2 alpha P B B' P = -Q, (34), with whatever stands for A. Raises StructureError if none is found."""
    try:
        P = linalg.solve_continuous_are(A, B, Q, np.eye(B.shape[1]) / (2 * alpha))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise StructureError(f"the Riccati equation (34) has no stabilising solution here: {error}") from None
    left = A.T @ P + P @ A - 2 * alpha * P @ B @ B.T @ P
    return Riccati(P, alpha * B.T @ P, float(np.linalg.norm(left + Q) / max(np.linalg.norm(Q), np.linalg.norm(A.T @ P))))


def feedback(linear: Matrices, alpha: float, Q: Floats, Ts: float | None) -> Floats:
    """K (m x n) of (34) with A, or its sampled counterpart, which tends to it as Ts -> 0. Raises StructureError.

    K = alpha B'P is half the optimal gain for R = 1 / (2 alpha); sampled: half of (R + B'PB)^-1 B'PA of the discrete
    equation with Q Ts, R Ts.
    """
    A, B, _ = linear
    if Ts is None:
        return paper_riccati(A, B, alpha, Q).K
    R = np.eye(B.shape[1]) * Ts / (2 * alpha)
    try:
        P = linalg.solve_discrete_are(A, B, Q * Ts, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise StructureError(f"the discrete Riccati equation has no stabilising solution here: {error}") from None
    K = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A) / 2
    radius = float(np.abs(np.linalg.eigvals(A - B @ K)).max())
    if radius >= 1:
        raise StructureError(f"controller.alpha: (34) sampled at {Ts:g} s does not stabilise (spectral radius {radius:.4g}); use a smaller step or poles")
    return np.asarray(K)


def lyapunov(linear: Matrices, K: Floats, Q: Floats, Ts: float | None) -> Floats:
    """P of (A - BK)'P + P(A - BK) = -Q, or of its sampled form. Raises StructureError if A - BK is not stable."""
    closed = linear.A - linear.B @ K
    poles = np.linalg.eigvals(closed)
    if (poles.real.max() >= 0) if Ts is None else (np.abs(poles).max() >= 1):
        raise StructureError(f"controller: A - BK is not stable, its poles are {poles.round(4).tolist()}")
    return np.asarray(linalg.solve_continuous_lyapunov(closed.T, -Q) if Ts is None else linalg.solve_discrete_lyapunov(closed.T, Q))
