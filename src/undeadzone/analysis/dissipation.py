"""The inequality V' + supply < 0 for V = x'Px as matrices: Clarabel searches, eigenvalues prove."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np

from undeadzone.linalg.matrices import symmetric_part
from undeadzone.linalg.riccati import storage_of
from undeadzone.numerics.semidefinite import minimise_semidefinite, symmetric_matrix
from undeadzone.util.arrays import Floats

# Smallest eigenvalue of P, and smallest multiplier, that the solver may choose when balanced.
LEAST = 1e-8
CANCELLED = 1e-7  # of its terms, below which a diagonal entry counts as cancelled


class Inequality(NamedTuple):
    """Inequality V' + 2 decay V + supply < 0 in (x, b) along x' = A x + B b.

    The inequality holds for every vertex and supply.

    Sampled, A and B are in delta form, x+ = x + Ts (A x + B b), and V' stands for (V+ - V)/Ts.

    Attributes:
        A: the vertices (each n x n) [1/s].
        B: how b enters x' (n x b).
        supply: the supplies (each (n + b) x (n + b)).
        size: the supplies with every term replaced by its magnitude, for the bound on rounding.
        Ts: sample time [s] (None in continuous time).
        decay: rate [1/s] at which sqrt(V) must fall.
    """

    A: tuple[Floats, ...]
    B: Floats
    supply: tuple[Floats, ...]
    size: tuple[Floats, ...]
    Ts: float | None
    decay: float = 0.0

    def lmi_matrices(self, P: Floats) -> list[Floats]:
        """Return a matrix per vertex and supply, affine in P.

        The sampled square term is bordered by -P.

        Args:
            P: of V = x'Px (n x n).
        """
        pairs = product(self.A, self.supply)
        return [_vertex_matrix(P, A, self.B, supply, self.Ts, self.decay) for A, supply in pairs]

    def term_magnitudes(self, P: Floats) -> list[Floats]:
        """Return the sums of `lmi_matrices` with every term replaced by its magnitude."""
        P_size = np.abs(P)
        B_size = np.abs(self.B)
        magnitudes = []
        for A in self.A:
            for size in self.size:
                sums = _vertex_matrix(P_size, np.abs(A), B_size, size, self.Ts, self.decay)
                magnitudes.append(np.abs(sums))
        return magnitudes

    def transform_coordinates(self, T: Floats, inverse: Floats) -> Inequality:
        """Return the inequality in coordinates x = T xi.

        Args:
            T: the change of coordinates (n x n).
            inverse: its inverse.
        """
        return self._replace(
            A=tuple(inverse @ A @ T for A in self.A),
            B=inverse @ self.B,
            supply=tuple(_transform_supply(supply, T) for supply in self.supply),
        )


def _transform_supply(supply: Floats, T: Floats) -> Floats:
    """Return a supply in (x, b) as a supply in (xi, b), x = T xi."""
    n = T.shape[0]
    supply = supply.copy()
    supply[:n] = T.T @ supply[:n]
    supply[:, :n] = supply[:, :n] @ T
    return supply


def _vertex_matrix(
    P: Floats, A: Floats, B: Floats, supply: Floats, Ts: float | None, decay: float
) -> Floats:
    """Return the matrix of V' + 2 decay V + supply at a vertex, with a third block row if
    sampled.
    """
    n = A.shape[0]
    PF = P @ np.hstack([A, B])  # F = [A, B]
    top = supply.copy()
    top[:n] += PF
    top[:, :n] += PF.T
    top[:n, :n] += 2 * decay * P
    if Ts is None:
        return top
    border = np.sqrt(Ts) * PF.T
    return np.block([[top, border], [border.T, -P]])


def build_quadratic_form(
    sizes: list[int], terms: list[tuple[int, int, Floats]]
) -> tuple[Floats, Floats]:
    """Return a symmetric matrix from blocks, and the sum of the blocks' magnitudes.

    Args:
        sizes: the lengths of the parts of its vector.
        terms: (row, column, value) of each block. The mirror image of an off-diagonal block is
            added too, and blocks at one place are added up.
    """
    ends = np.cumsum([0, *sizes])
    total = np.zeros((ends[-1], ends[-1]))
    size = np.zeros((ends[-1], ends[-1]))
    for i, j, value in terms:
        rows = slice(ends[i], ends[i + 1])
        columns = slice(ends[j], ends[j + 1])
        total[rows, columns] += value
        size[rows, columns] += np.abs(value)
        if i != j:
            total[columns, rows] += value.T
            size[columns, rows] += np.abs(value).T
    return total, size


class Solution(NamedTuple):
    """Solution of the semidefinite program.

    Attributes:
        P: of V = x'Px (n x n).
        q: the multipliers, on which the supplies depend.
    """

    P: Floats
    q: Floats


Family = Callable[[Floats], Inequality]  # the inequality for multipliers q, affine in them
Extra = Callable[[Floats, Floats], list[Floats]]  # more (P, q) that must be >= 0, affine in them


def no_constraints(P: Floats, q: Floats) -> list[Floats]:
    """Return no further constraint on P and q."""
    return []


def optimise_storage(
    family: Family,
    cost: Floats,
    start: Floats,
    extra: Extra,
    deep: bool = False,
    passes: int = 2,
) -> Solution | None:
    """Return P, q of least cost'q, or deepest inside, under `family(q)` and `extra`, or None.

    Each pass works in coordinates in which the last P was the identity and the last matrices had a
    unit diagonal. A stiff plant needs that. The first P is of Lyapunov's equation, or else the
    identity. The result is the solver's statement and not a proof.

    Args:
        family: q -> the inequality, affine in q.
        cost: weights of the multipliers.
        start: q that sets the scale of the first pass.
        extra: P, q -> an array that must be positive semidefinite (2-D) or non-negative (1-D).
        deep: whether to seek the point deepest inside rather than that of least cost, as far as
            the check needs.
        passes: how many there are at most.

    Returns:
        The last pass's solution, or None if there is none.
    """
    A = family(start).A[0]
    Ts = family(start).Ts
    for first in (_lyapunov_storage(A, Ts), np.eye(len(A))):
        best = None
        if not np.isfinite(first).all():
            continue
        near = Solution(first, start)
        for _ in range(passes):
            solution = _solve_in_local_units(family, cost, extra, deep, near)
            if solution is None:
                break
            best = near = solution
            if deep and check_inequality(family(solution.q), solution.P).proved:
                break
        if best is not None:
            return best
    return None


def _solve_in_local_units(
    family: Family, cost: Floats, extra: Extra, deep: bool, near: Solution
) -> Solution | None:
    """Return a solution or None, in coordinates with P of `near` = I.

    The matrices of `near` have a unit diagonal there.
    """
    P, q = near
    n = len(P)
    values, vectors = np.linalg.eigh(P)
    if not values[-1] > 0:
        return None
    root = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    T = vectors / root
    inverse = (vectors * root).T
    units = (np.zeros(cost.size), *np.eye(cost.size))
    at = _affine_family([family(unit).transform_coordinates(T, inverse) for unit in units])
    scales = _diagonal_scales(at(q), np.eye(n))
    entries = n * (n + 1) // 2  # of P; then come the multipliers, and the depth if it is sought
    part = at(q).supply[0].shape[0]

    def blocks(x: Floats) -> list[Floats]:
        """Return the matrices that must be positive semidefinite."""
        local = symmetric_matrix(x[:entries], n)
        q = x[entries : entries + cost.size]
        scaled = []
        for M, scale in zip(at(q).lmi_matrices(local), scales, strict=True):
            block = -M * np.outer(scale, scale)
            if deep:
                block[np.arange(part), np.arange(part)] -= x[-1]
            scaled.append(block)
        return [*scaled, local - LEAST * np.eye(n), *extra(inverse.T @ local @ inverse, q)]

    x = minimise_semidefinite(np.concatenate([np.zeros(entries), cost, [-1.0] * deep]), blocks)
    if x is None:
        return None
    P = inverse.T @ symmetric_matrix(x[:entries], n) @ inverse
    return Solution(symmetric_part(P), x[entries : entries + cost.size])


def _diagonal_scales(inequality: Inequality, P: Floats) -> list[Floats]:
    """Return the factors of rows and columns that give each matrix a diagonal of -1.

    A diagonal entry whose terms cancel to nothing does not show its size: the magnitude of the
    terms does.
    """
    scales = []
    for M, size in zip(inequality.lmi_matrices(P), inequality.term_magnitudes(P), strict=True):
        diagonal = np.maximum(np.abs(np.diag(M)), CANCELLED * np.diag(size))
        scales.append(np.maximum(diagonal, 1e-300) ** -0.5)
    return scales


def _affine_family(points: list[Inequality]) -> Family:
    """Return q -> Inequality from its values at q = 0 and the unit vectors. Only the supplies
    vary.
    """
    base = np.stack(points[0].supply)
    slopes = np.stack([np.stack(point.supply) - base for point in points])[1:]
    return lambda q: points[0]._replace(supply=tuple(base + np.tensordot(q, slopes, 1)))


def find_storage(inequality: Inequality) -> Floats | None:
    """Return a candidate P (n x n) deep inside the inequality or near it, or None."""
    found = deepest_solution(lambda q: inequality, np.zeros(0))
    return None if found is None else found.P


def deepest_solution(
    family: Family, start: Floats, extra: Extra = no_constraints
) -> Solution | None:
    """Return P, q deepest inside the inequality and `extra`, or as deep as the check needs."""
    return optimise_storage(family, np.zeros(start.size), start, extra, deep=True, passes=4)


def _lyapunov_storage(A: Floats, Ts: float | None) -> Floats:
    """Return P of A'P + PA = -I (n x n).

    A sampled A is mapped by Tustin's rule, which keeps P.
    """
    identity = np.eye(A.shape[0])
    if Ts is not None:
        A = np.linalg.solve(identity + Ts / 2 * A, A)
    return storage_of(A, identity, None)


class DefinitenessCheck(NamedTuple):
    """Check that P and the inequality are definite beyond rounding.

    Attributes:
        proved: whether both are.
        lmi: greatest eigenvalue of the inequality, scaled to a diagonal of -1.
        P: least eigenvalue of P, scaled to a unit diagonal.
        rounding: how far both must stay from 0.
    """

    proved: bool
    lmi: float
    P: float
    rounding: float


NO_PROOF = DefinitenessCheck(False, np.inf, -np.inf, 0.0)  # result without any proof


def check_inequality(inequality: Inequality, P: Floats) -> DefinitenessCheck:
    """Check by eigenvalues and a bound on rounding, without a solver, that P proves the
    inequality.

    P must be symmetric to the last bit. x'Px holds only the symmetric part, and PA + A'P' of
    another P can be negative although A is unstable.

    Args:
        inequality: the inequality to prove.
        P: of V = x'Px (n x n).
    """
    n = inequality.A[0].shape[0]
    if P.shape != (n, n) or not np.isfinite(P).all() or not np.array_equal(P, P.T):
        return NO_PROOF
    matrices = map(np.negative, inequality.lmi_matrices(P))
    of_lmi = map(_least_eigenvalue_and_rounding, matrices, inequality.term_magnitudes(P))
    least, rounding = np.array([_least_eigenvalue_and_rounding(P, np.abs(P)), *of_lmi]).T
    proved = bool((least > rounding).all())
    return DefinitenessCheck(proved, -least[1:].min(), least[0], rounding.max())


def _least_eigenvalue_and_rounding(M: Floats, size: Floats) -> tuple[float, float]:
    """Return (least eigenvalue of M scaled to a unit diagonal, bound on its rounding).

    The first is -inf if a diagonal entry is not positive. size: the sums of magnitudes behind M.
    """
    diagonal = np.diag(M)
    if not np.isfinite(M).all() or (diagonal <= 0).any():
        return -np.inf, 0.0
    n = M.shape[0]
    scale = 1 / np.sqrt(np.outer(diagonal, diagonal))
    unit = 4 * (n + 4) * np.finfo(float).eps
    rounding = unit * (np.linalg.norm(size * scale) + n)
    return float(np.linalg.eigvalsh(symmetric_part(M) * scale)[0]), float(rounding)
