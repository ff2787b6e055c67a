"""The certificate that replaces Theorem 4.1: one quadratic V for every switching sequence (docs/theory.md, section 3).

Continuous: M = [[A'P + PA, C'W - PL], [., -2W]] < 0. Sampled, in delta form with A_d = (Ad - I)/Ts and L, gamma per
second: [[A_d'P + P A_d, C'W - PL, sqrt(Ts) A_d'P], [., Ts W gamma - 2W, -sqrt(Ts) L'P], [., ., -P]] < 0.
Then V = x~'P x~ + sum_i w_i / gamma_i (d~_ri^2 + d~_li^2) never rises.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.arrays import Floats
from undeadzone.plant import Matrices


class Certificate(NamedTuple):
    """certified, its proof P (n x n) and W (p), and largest eigenvalues: of the LMI (negative) and least of P (positive)."""

    certified: bool
    P: Floats
    W: Floats
    lmi_max: float
    P_min: float

    def value(self, x_error: Floats, d_error: Floats, gamma: Floats) -> Floats:
        """V along errors x - x^ (N x n) and [right, left] widths (N x 2p); gamma (p) per second."""
        widths = np.repeat(self.W / gamma, 2)
        return np.einsum("ki,ij,kj->k", x_error, self.P, x_error) + (d_error**2) @ widths


def delta(linear: Matrices, Ts: float | None) -> Floats:
    """A, or (Ad - I) / Ts for a sampled model: the matrix that tends to A as Ts -> 0."""
    A = linear.A
    return A if Ts is None else (A - np.eye(A.shape[0])) / Ts


def lmi(A: Floats, C: Floats, L: Floats, gamma: Floats, Ts: float | None, P: Floats, W: Floats) -> Floats:
    """The symmetric matrix that must be negative definite; A in delta form, L and gamma per second."""
    cross = C.T * W - P @ L
    corner = -2 * np.diag(W)
    top = A.T @ P + P @ A
    if Ts is None:
        return np.block([[top, cross], [cross.T, corner]])
    root = np.sqrt(Ts)
    return np.block(
        [
            [top, cross, root * A.T @ P],
            [cross.T, corner + Ts * np.diag(W * gamma), -root * L.T @ P],
            [root * P @ A, -root * P @ L, -P],
        ]
    )


def certify(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None = None) -> Certificate:
    """Search P, W for gains L (n x p) [1/s] and gamma (p) [1/s] with Clarabel, then judge the answer by eigenvalues alone."""
    A, C = delta(linear, Ts), linear.C
    n, p = C.shape[1], C.shape[0]
    P, W = _solve(A, C, L, gamma, Ts)
    if P is None or W is None:
        return Certificate(False, np.eye(n), np.ones(p), np.inf, 0.0)
    eig = float(np.linalg.eigvalsh(lmi(A, C, L, gamma, Ts, P, W))[-1])
    low = float(np.linalg.eigvalsh(P)[0])
    scale = np.linalg.norm(P, 2)
    return Certificate(bool(eig < -1e-9 * max(1.0, scale) and low > 1e-12 * scale and W.min() > 0), P, W, eig, low)


def passive_gain(linear: Matrices, Ts: float | None) -> Floats:
    """L = P^-1 C' [1/s] with A'P + PA = -2 w I (delta form), w the size of A: certified for every stable model.

    Raises StructureError if the model is not stable.
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    from undeadzone.errors import StructureError

    A = delta(linear, Ts)
    n = A.shape[0]
    stable = np.linalg.eigvals(A).real.max() < 0 if Ts is None else np.abs(np.linalg.eigvals(linear.A)).max() < 1
    if not stable:
        raise StructureError("observer.L: missing; there is a default only for a stable model, give L")
    Q = 2 * np.linalg.norm(A, 2) * np.eye(n)
    P = solve_continuous_lyapunov(A.T, -Q) if Ts is None else Ts * solve_discrete_lyapunov(linear.A.T, Q)
    return np.asarray(np.linalg.solve(P, linear.C.T))


def _solve(A: Floats, C: Floats, L: Floats, gamma: Floats, Ts: float | None) -> tuple[Floats | None, Floats | None]:
    """Maximise t with LMI + t I <= 0, P >= t I, sum W = p; the matrices are affine in (P, W, t), read off one at a time."""
    import clarabel
    from scipy import sparse

    n, p = C.shape[1], C.shape[0]
    pairs = [(i, j) for j in range(n) for i in range(j + 1)]
    none = np.zeros((n, n))

    def unit(i: int, j: int) -> Floats:
        P = np.zeros((n, n))
        P[i, j] = P[j, i] = 1.0
        return P

    columns = [(lmi(A, C, L, gamma, Ts, unit(i, j), np.zeros(p)), -unit(i, j)) for i, j in pairs]
    columns += [(lmi(A, C, L, gamma, Ts, none, w), none) for w in np.eye(p)]
    rows = columns[0][0].shape[0]
    columns.append((np.eye(rows), np.eye(n)))
    G = np.stack([np.concatenate([_svec(first), _svec(second)]) for first, second in columns], axis=1)
    total = np.concatenate([np.zeros(len(pairs)), np.ones(p), [0.0]])[None, :]
    nonneg = np.hstack([np.zeros((p, len(pairs))), -np.eye(p), np.zeros((p, 1))])
    matrix = sparse.csc_matrix(np.vstack([total, nonneg, G]))
    right = np.concatenate([[float(p)], np.zeros(p), np.zeros(G.shape[0])])
    cost = np.zeros(len(columns))
    cost[-1] = -1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.ZeroConeT(1), clarabel.NonnegativeConeT(p), clarabel.PSDTriangleConeT(rows), clarabel.PSDTriangleConeT(n)]
    solution = clarabel.DefaultSolver(sparse.csc_matrix((len(cost), len(cost))), cost, matrix, right, cones, settings).solve()
    x = np.asarray(solution.x)
    if x.size != len(cost) or not np.isfinite(x).all():
        return None, None
    P = np.zeros((n, n))
    for (i, j), value in zip(pairs, x, strict=False):
        P[i, j] = P[j, i] = value
    return P, x[len(pairs) : -1]


def _svec(symmetric: Floats) -> Floats:
    """Upper triangle column by column, off-diagonals times sqrt 2, as Clarabel's semidefinite cone wants it."""
    size = symmetric.shape[0]
    column, row = np.tril_indices(size)
    return symmetric[row, column] * np.where(row == column, 1.0, np.sqrt(2.0))
