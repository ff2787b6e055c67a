"""The least eigenvalue of D + Herm C (jw - A)^-1 L over all frequencies is found by level sets.

No grid of frequencies is needed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.support.arrays import Floats

TOLERANCE = 1e-11  # of the response's size: how far the least value may lie below the answer


class Response(NamedTuple):
    """G(s) = C (s - A)^-1 L + D with a stable A.

    Attributes:
        A, C, L, D: its matrices (n x n, p x n, n x p, p x p).
        Ts: sample time [s] that it was mapped from by Tustin's rule; None in continuous time.
    """

    A: Floats
    C: Floats
    L: Floats
    D: Floats
    Ts: float | None = None

    def at(self, w: Floats) -> np.ndarray:
        """(G + G*)/2 (len(w) x p x p, complex) at frequencies w of the mapped axis.

        Args:
            w: frequencies [rad/s]; inf is allowed.
        """
        G = self.values(w)
        return np.asarray(G + G.conj().transpose(0, 2, 1)) / 2

    def values(self, w: Floats) -> np.ndarray:
        """G (len(w) x p x p, complex) at frequencies w of the mapped axis.

        Args:
            w: frequencies [rad/s]; inf is allowed.
        """
        finite = np.isfinite(w)
        G = np.zeros((w.size, *self.D.shape), complex)
        s = 1j * w[finite]
        pencils = s[:, None, None] * np.eye(self.A.shape[0]) - self.A
        G[finite] = self.C @ np.linalg.solve(pencils, self.L[None].astype(complex))
        return np.asarray(G + self.D)

    def frequency(self, w: float) -> float:
        """The true frequency [rad/s] of a frequency of the mapped axis."""
        return w if self.Ts is None else float(2 * np.arctan(w * self.Ts / 2) / self.Ts)


class Worst(NamedTuple):
    """The least eigenvalue and where it occurs.

    Attributes:
        value: the eigenvalue.
        direction: its eigenvector (p, complex).
        w: frequency on the response's own axis [rad/s].
    """

    value: float
    direction: np.ndarray
    w: float


def response(A: Floats, C: Floats, L: Floats, D: Floats, Ts: float | None) -> Response:
    """D + C (s - A)^-1 L on the imaginary axis.

    Sampled, for A = (Ad - I)/Ts and L = Ld/Ts, Tustin's rule gives the same values there.

    Args:
        A, C, L, D: its matrices (n x n, p x n, n x p, p x p).
        Ts: sample time [s]; None in continuous time.
    """
    if Ts is None:
        return Response(A, C, L, D)
    M = np.linalg.inv(np.eye(A.shape[0]) + Ts / 2 * A)
    return Response(A @ M, C, M @ M @ L, D - Ts / 2 * C @ M @ L, Ts)


def worst(G: Response) -> Worst:
    """Minimum over w in [0, inf] of the least eigenvalue of Herm G(jw); A must be stable.

    At a level m every frequency where an eigenvalue of Herm G crosses m is the imaginary part of an
    eigenvalue of the pencil below; the least value at those and halfway between (both means) is the
    next level, until it falls no further (Boyd and Balakrishnan 1990, Bruinsma and Steinbuch 1990).
    """
    A, C, L, D, _ = G
    n, p = A.shape[0], D.shape[0]
    poles = np.linalg.eigvals(A)
    around = np.outer(2.0 ** np.arange(-3, 4), np.abs(poles)).ravel()
    best = _least(G, np.concatenate([[0.0, np.inf], around, np.abs(poles.imag)]))
    size = max(float(np.linalg.norm(D)), 1.0)
    zero = np.zeros((n, n))
    while True:
        level = best.value - TOLERANCE * size
        R = D + D.T - 2 * level * np.eye(p)
        pencil = np.block([[A, zero, L], [zero, -A.T, -C.T], [C, L.T, R]])
        crossings = np.append(np.unique(np.abs(_finite_eigenvalues(pencil, 2 * n).imag)), np.inf)
        a, b = crossings[:-2], crossings[1:-1]
        lower = _least(G, np.concatenate([crossings, (a + b) / 2, np.sqrt(a * b)]))
        if not lower.value < level:
            return best
        best = lower


def _finite_eigenvalues(pencil: Floats, n: int) -> np.ndarray:
    """Eigenvalues s of pencil - s diag(I_n, 0) that are finite."""
    A, B = pencil[:n, :n], pencil[:n, n:]
    C, D = pencil[n:, :n], pencil[n:, n:]
    least = np.linalg.svd(D, compute_uv=False)[-1]
    if np.linalg.norm(B) * np.linalg.norm(C) < 1e4 * np.linalg.norm(A) * least:
        return np.linalg.eigvals(A - B @ np.linalg.solve(D, C))
    from scipy.linalg import eigvals

    mass = np.diag(np.r_[np.ones(n), np.zeros(D.shape[0])])
    alpha, beta = eigvals(pencil, mass, homogeneous_eigvals=True)
    finite = np.abs(beta) > 1e-12 * np.abs(alpha)
    return np.asarray(alpha[finite] / beta[finite])


def _least(G: Response, w: Floats) -> Worst:
    """The least eigenvalue of Herm G at some frequencies."""
    values, vectors = np.linalg.eigh(G.at(w))
    k = int(np.argmin(values[:, 0]))
    return Worst(float(values[k, 0]), vectors[k, :, 0], float(w[k]))
