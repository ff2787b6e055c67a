"""The inequality V' + supply < 0 for V = x'Px: as matrices, searched by Clarabel, proved by eigenvalues alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.numerics.semidefinite import minimise, symmetric
from undeadzone.support.arrays import Floats

LEAST = 1e-8  # smallest eigenvalue of P, and smallest multiplier, that the solver may choose in balanced coordinates


class Inequality(NamedTuple):
    """For every vertex A (n x n) and every supply ((n + b) x (n + b)): V' + 2 decay V + supply < 0 in (x, b), x' = A x + B b.

    Sampled, A and B are in delta form, x+ = x + Ts (A x + B b), and V' stands for (V+ - V)/Ts. size: the supplies with
    every term replaced by its magnitude, for the bound on rounding.
    """

    A: tuple[Floats, ...]
    B: Floats
    supply: tuple[Floats, ...]
    size: tuple[Floats, ...]
    Ts: float | None
    decay: float = 0.0

    def matrices(self, P: Floats) -> list[Floats]:
        """One matrix per vertex and supply, affine in P; the sampled square term is bordered by -P."""
        return [
            _matrix(P, A, self.B, supply, self.Ts, self.decay)
            for A in self.A
            for supply in self.supply
        ]

    def magnitudes(self, P: Floats) -> list[Floats]:
        """The same sums with every term replaced by its magnitude."""
        return [
            np.abs(_matrix(np.abs(P), np.abs(A), np.abs(self.B), size, self.Ts, self.decay))
            for A in self.A
            for size in self.size
        ]

    def transformed(self, T: Floats, inverse: Floats) -> Inequality:
        """The same inequality in coordinates x = T xi."""
        n = T.shape[0]

        def moved(supply: Floats) -> Floats:
            supply = supply.copy()
            supply[:n] = T.T @ supply[:n]
            supply[:, :n] = supply[:, :n] @ T
            return supply

        return self._replace(
            A=tuple(inverse @ A @ T for A in self.A),
            B=inverse @ self.B,
            supply=tuple(moved(supply) for supply in self.supply),
        )


def _matrix(
    P: Floats, A: Floats, B: Floats, supply: Floats, Ts: float | None, decay: float
) -> Floats:
    n = A.shape[0]
    PF = P @ np.hstack([A, B])
    top = supply.copy()
    top[:n] += PF
    top[:, :n] += PF.T
    top[:n, :n] += 2 * decay * P
    if Ts is None:
        return top
    border = np.sqrt(Ts) * PF.T
    return np.block([[top, border], [border.T, -P]])


def quadratic(sizes: list[int], terms: list[tuple[int, int, Floats]]) -> tuple[Floats, Floats]:
    """(the symmetric matrix with these blocks (row, column, value) and their mirror images added up, the sum of their magnitudes)."""
    ends = np.cumsum([0, *sizes])
    total, size = np.zeros((ends[-1], ends[-1])), np.zeros((ends[-1], ends[-1]))
    for i, j, value in terms:
        rows, columns = slice(ends[i], ends[i + 1]), slice(ends[j], ends[j + 1])
        total[rows, columns] += value
        size[rows, columns] += np.abs(value)
        if i != j:
            total[columns, rows] += value.T
            size[columns, rows] += np.abs(value).T
    return total, size


class Found(NamedTuple):
    """What the solver found: P (n x n) and the multipliers q."""

    P: Floats
    q: Floats


def optimise(
    family: Callable[[Floats], Inequality],
    cost: Floats,
    start: Floats,
    extra: Callable[[Floats, Floats], list[Floats]] = lambda P, q: [],
    deep: bool = False,
    done: Callable[[Found], bool] = lambda found: False,
    passes: int = 2,
) -> Found | None:
    """P, q that minimise cost'q, or lie deepest inside, with family(q) (affine) satisfied and extra(P, q) >= 0; None if there is none.

    Each pass works in coordinates where the last P was the identity and the last matrices had a unit diagonal, until
    `done`; a stiff plant needs that. The first P is of Lyapunov's equation, or else the identity. start: q that sets the
    scale of the first pass. What comes back is the solver's word.
    """
    A, Ts = family(start).A[0], family(start).Ts
    for first in (_lyapunov(A, Ts), np.eye(len(A))):
        best, at = None, Found(first, start)
        for _ in range(passes):
            found = _pass(family, cost, extra, deep, at)
            if found is None:
                break
            best = at = found
            if done(found):
                break
        if best is not None:
            return best
    return None


def _pass(
    family: Callable[[Floats], Inequality],
    cost: Floats,
    extra: Callable[[Floats, Floats], list[Floats]],
    deep: bool,
    near: Found,
) -> Found | None:
    """One solution in coordinates where the P of `near` is the identity and its matrices have a unit diagonal."""
    P, q = near
    values, vectors = np.linalg.eigh(P)
    if not values[-1] > 0:
        return None
    root = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    T, inverse = vectors / root, (vectors * root).T
    at = _affine(
        [family(unit).transformed(T, inverse) for unit in (np.zeros(cost.size), *np.eye(cost.size))]
    )
    scales = [
        np.maximum(np.abs(np.diag(M)), 1e-300) ** -0.5 for M in at(q).matrices(np.eye(len(P)))
    ]
    entries, part = len(P) * (len(P) + 1) // 2, at(q).supply[0].shape[0]

    def blocks(x: Floats) -> list[Floats]:
        local, q = symmetric(x[:entries], len(P)), x[entries : entries + cost.size]
        found = []
        for M, scale in zip(at(q).matrices(local), scales, strict=True):
            block = -M * np.outer(scale, scale)
            if deep:
                block[np.arange(part), np.arange(part)] -= x[-1]
            found.append(block)
        return [*found, local - LEAST * np.eye(len(P)), *extra(inverse.T @ local @ inverse, q)]

    x = minimise(np.concatenate([np.zeros(entries), cost, [-1.0] * deep]), blocks)
    if x is None:
        return None
    P = inverse.T @ symmetric(x[:entries], len(P)) @ inverse
    return Found((P + P.T) / 2, x[entries : entries + cost.size])


def _affine(points: list[Inequality]) -> Callable[[Floats], Inequality]:
    """q -> Inequality through its values at q = 0 and at the unit vectors; only the supplies depend on q."""
    base = np.stack(points[0].supply)
    slopes = np.stack([np.stack(point.supply) - base for point in points])[1:]
    return lambda q: points[0]._replace(supply=tuple(base + np.tensordot(q, slopes, 1)))


def storage(inequality: Inequality) -> Floats | None:
    """P deep inside the inequality, or as near to it as there is one; None if the solver finds nothing at all."""
    none = np.zeros(0)
    found = optimise(
        lambda q: inequality,
        none,
        none,
        deep=True,
        done=lambda found: check(inequality, found.P).proved,
        passes=4,
    )
    return None if found is None else found.P


def _lyapunov(A: Floats, Ts: float | None) -> Floats:
    """P of A'P + PA = -I; a sampled A is mapped by Tustin's rule, which keeps P."""
    from scipy.linalg import solve_continuous_lyapunov

    identity = np.eye(A.shape[0])
    if Ts is not None:
        A = np.linalg.solve(identity + Ts / 2 * A, A)
    return np.asarray(solve_continuous_lyapunov(A.T, -identity))


class Check(NamedTuple):
    """Whether P and the inequality are definite beyond rounding.

    lmi: greatest eigenvalue of the inequality, scaled to a diagonal of -1; P: least eigenvalue of P, scaled to a unit
    diagonal; rounding: how far both must stay from 0.
    """

    proved: bool
    lmi: float
    P: float
    rounding: float


def check(inequality: Inequality, P: Floats) -> Check:
    """Whether P proves the inequality: eigenvalues and a bound on the rounding of every entry, no solver."""
    if not np.isfinite(P).all():
        return Check(False, np.inf, -np.inf, 0.0)
    pairs = zip(inequality.matrices(P), inequality.magnitudes(P), strict=True)
    found = [_definite(P, np.abs(P)), *(_definite(-M, size) for M, size in pairs)]
    proved = all(value > slack for value, slack in found)
    return Check(
        proved, -min(value for value, _ in found[1:]), found[0][0], max(slack for _, slack in found)
    )


def _definite(M: Floats, size: Floats) -> tuple[float, float]:
    """(least eigenvalue of M scaled to a unit diagonal, bound on its rounding); -inf if a diagonal entry is not positive."""
    diagonal = np.diag(M)
    if not np.isfinite(M).all() or (diagonal <= 0).any():
        return -np.inf, 0.0
    scale = 1 / np.sqrt(np.outer(diagonal, diagonal))
    rounding = (
        4 * (M.shape[0] + 4) * np.finfo(float).eps * (np.linalg.norm(size * scale) + M.shape[0])
    )
    return float(np.linalg.eigvalsh((M + M.T) / 2 * scale)[0]), float(rounding)
