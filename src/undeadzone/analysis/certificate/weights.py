"""Weights of the outputs under which error dynamics have the largest margin.

W and the storage P are searched together, one LMI a step. For one A the margin of a W is a least
eigenvalue over frequencies, that of D + Herm C (jw - A)^-1 L, found by level sets: no grid, no
solver.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.dissipation import LEAST, Inequality, optimise_storage
from undeadzone.analysis.error_dynamics import Dynamics
from undeadzone.util.arrays import Floats

SEARCHES: Final = 20  # steps of Dinkelbach's iteration, at most
ENOUGH: Final = 1e-6  # of the margin: how much better another W may be
TOLERANCE = 1e-11  # of the response's size: how far the least value may lie below the answer


class OutputWeights(NamedTuple):
    """Weights W (p), their margin and its frequency [rad/s]."""

    W: Floats
    margin: float
    frequency: float | None


def margin_of_weights(errors: Dynamics, W: Floats) -> tuple[float, float]:
    """Return (margin for W, its frequency [rad/s]), exact, without a solver.

    Args:
        errors: error dynamics with one stable A.
        W: weights of the outputs (p).
    """
    (A,), C, L, _, Ts = errors
    root = np.sqrt(W)
    found = []
    for step in errors.largest_gain_steps:
        D = np.eye(root.size) - step / 2
        G = frequency_response(A, C * root[:, None], L / root, D, Ts)
        least = least_eigenvalue_over_frequencies(G)
        found.append((least.value, G.true_frequency(least.w)))
    return min(found)


def best_weights(errors: Dynamics) -> OutputWeights:
    """Return the weights that maximise the margin, with mean 1 over their groups.

    The largest m with M + 2m diag(0, W) <= 0 for some P is quasi-convex in W: Dinkelbach's
    iteration, one LMI a step. Of one A the margin of each W is exact.
    """
    equal = np.ones(errors.C.shape[0])
    best = OutputWeights(equal, -np.inf, None)
    shift = 0.0
    single = len(errors.A) == 1
    if single:
        best = OutputWeights(equal, *margin_of_weights(errors, equal))
        if errors.groups.shape[1] == 1:
            return best
        shift = best.margin
    for _ in range(SEARCHES):
        deepest = _deepest_weights(errors, shift)
        if deepest is None:
            break
        P, W = deepest
        trial = OutputWeights(W, _reachable_margin(errors, P, W), None)
        if single:
            trial = OutputWeights(W, *margin_of_weights(errors, W))
        gain = trial.margin - best.margin
        if gain > 0:
            best = trial
        if not gain >= ENOUGH * max(1.0, abs(best.margin)):
            break
        shift = best.margin
    return best


def _deepest_weights(errors: Dynamics, shift: float) -> tuple[Floats, Floats] | None:
    """Return (P, W) of largest t such that M + 2 diag(0, shift W + t I) <= 0, or None."""
    groups = errors.groups
    none = np.zeros((errors.L.shape[0], 0))

    def weights(q: Floats) -> Floats:
        """Return the output weights (p) for the free weights of groups q[:-1], whose mean is 1."""
        return groups @ np.append(q[:-1], groups.shape[1] - q[:-1].sum())

    def family(q: Floats) -> Inequality:
        """Return the inequality for q."""
        W = weights(q)
        return errors.extend_inequality(
            W,
            none,
            [(1, 1, np.diag(2 * (shift * W + q[-1])))],
        )

    def positive(P: Floats, q: Floats) -> list[Floats]:
        """Return the constraint that the weights are positive."""
        return [weights(q) - LEAST]

    start = np.append(np.ones(groups.shape[1] - 1), 0.0)
    solution = optimise_storage(
        family,
        -np.eye(start.size)[-1],
        start,
        positive,
        passes=1,
    )
    if solution is None:
        return None
    return solution.P, np.maximum(weights(solution.q), LEAST)


def _reachable_margin(errors: Dynamics, P: Floats, W: Floats) -> float:
    """Return the largest m with M + 2m diag(0, W) <= 0 for every M at P, or -inf if none exists."""
    n, p = errors.L.shape
    least = np.inf
    for M in errors.inequality(W).lmi_matrices(P):
        e = np.arange(n, n + p)  # the rows of the innovation
        rest = np.delete(np.arange(len(M)), e)
        if not np.linalg.eigvalsh(M[np.ix_(rest, rest)])[-1] < 0:
            return -np.inf
        cross = M[np.ix_(rest, e)]
        corner = M[np.ix_(e, e)] - cross.T @ np.linalg.solve(M[np.ix_(rest, rest)], cross)
        least = min(least, float(np.linalg.eigvalsh(-corner / np.sqrt(np.outer(W, W)) / 2)[0]))
    return least


class Response(NamedTuple):
    """Frequency response G(s) = C (s - A)^-1 L + D with a stable A.

    Attributes:
        A, C, L, D: its matrices (n x n, p x n, n x p, p x p).
        Ts: sample time [s] that it was mapped from by Tustin's rule (None in continuous time).
    """

    A: Floats
    C: Floats
    L: Floats
    D: Floats
    Ts: float | None = None

    def hermitian_part(self, w: Floats) -> np.ndarray:
        """Return (G + G*)/2 (len(w) x p x p, complex) at frequencies w of the mapped axis.

        Args:
            w: frequencies [rad/s] (inf is allowed).
        """
        G = self.response_values(w)
        return np.asarray(G + G.conj().transpose(0, 2, 1)) / 2

    def response_values(self, w: Floats) -> np.ndarray:
        """Return G (len(w) x p x p, complex) at frequencies w of the mapped axis.

        Args:
            w: frequencies [rad/s] (inf is allowed).
        """
        finite = np.isfinite(w)
        G = np.zeros((w.size, *self.D.shape), complex)
        s = 1j * w[finite]
        pencils = s[:, None, None] * np.eye(self.A.shape[0]) - self.A
        G[finite] = self.C @ np.linalg.solve(pencils, self.L[None].astype(complex))
        return np.asarray(G + self.D)

    def true_frequency(self, w: float) -> float:
        """Return the true frequency [rad/s] of a frequency of the mapped axis."""
        return w if self.Ts is None else float(2 * np.arctan(w * self.Ts / 2) / self.Ts)


class LeastEigenvalue(NamedTuple):
    """Least eigenvalue and its frequency.

    Attributes:
        value: the eigenvalue.
        w: frequency on the response's own axis [rad/s].
    """

    value: float
    w: float


def frequency_response(A: Floats, C: Floats, L: Floats, D: Floats, Ts: float | None) -> Response:
    """Return D + C (s - A)^-1 L on the imaginary axis.

    Sampled, for A = (Ad - I)/Ts and L = Ld/Ts, Tustin's rule gives the same values there.

    Args:
        A, C, L, D: its matrices (n x n, p x n, n x p, p x p).
        Ts: sample time [s] (None in continuous time).
    """
    if Ts is None:
        return Response(A, C, L, D)
    M = np.linalg.inv(np.eye(A.shape[0]) + Ts / 2 * A)
    return Response(A @ M, C, M @ M @ L, D - Ts / 2 * C @ M @ L, Ts)


def least_eigenvalue_over_frequencies(G: Response) -> LeastEigenvalue:
    """Return the minimum over w in [0, inf] of the least eigenvalue of Herm G(jw), for a
    stable A.

    At a level m every frequency at which an eigenvalue of Herm G crosses m is the imaginary part of
    an eigenvalue of the pencil below. The least value at those and halfway between (both means) is
    the next level, until it falls no further (Boyd and Balakrishnan 1990, Bruinsma and Steinbuch
    1990).
    """
    A, C, L, D, _ = G
    n = A.shape[0]
    p = D.shape[0]
    poles = np.linalg.eigvals(A)
    around = np.outer(2.0 ** np.arange(-3, 4), np.abs(poles)).ravel()
    best = _least_eigenvalue_at(G, np.concatenate([[0.0, np.inf], around, np.abs(poles.imag)]))
    size = max(float(np.linalg.norm(D)), 1.0)
    zero = np.zeros((n, n))
    while True:
        level = best.value - TOLERANCE * size
        R = D + D.T - 2 * level * np.eye(p)
        pencil = np.block([[A, zero, L], [zero, -A.T, -C.T], [C, L.T, R]])
        crossings = np.append(np.unique(np.abs(_finite_eigenvalues(pencil, 2 * n).imag)), np.inf)
        a = crossings[:-2]
        b = crossings[1:-1]
        lower = _least_eigenvalue_at(G, np.concatenate([crossings, (a + b) / 2, np.sqrt(a * b)]))
        if not lower.value < level:
            return best
        best = lower


def _finite_eigenvalues(pencil: Floats, n: int) -> np.ndarray:
    """Return the finite eigenvalues s of pencil - s diag(I_n, 0)."""
    A = pencil[:n, :n]
    B = pencil[:n, n:]
    C = pencil[n:, :n]
    D = pencil[n:, n:]
    least = np.linalg.svd(D, compute_uv=False)[-1]
    if np.linalg.norm(B) * np.linalg.norm(C) < 1e4 * np.linalg.norm(A) * least:
        return np.linalg.eigvals(A - B @ np.linalg.solve(D, C))
    from scipy.linalg import eigvals

    mass = np.diag(np.r_[np.ones(n), np.zeros(D.shape[0])])
    alpha, beta = eigvals(pencil, mass, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-12 * np.abs(alpha)
    return np.asarray(alpha[finite] / beta[finite])


def _least_eigenvalue_at(G: Response, w: Floats) -> LeastEigenvalue:
    """Return the least eigenvalue of Herm G at some frequencies."""
    values = np.linalg.eigvalsh(G.hermitian_part(w))[:, 0]
    k = int(np.argmin(values))
    return LeastEigenvalue(float(values[k]), float(w[k]))
