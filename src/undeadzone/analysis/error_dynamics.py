"""The error dynamics as one object: what switches, what adapts, and the scaling in which they are solved.

Errors obey x~' = A x~ - L e, d~' = Gamma S'e with the innovation e = theta (C x~ - S d~), 0 <= theta <= 1, where the
measured side fixes S: +1 at d_r of an output read on the right, -1 at d_l on the left, e = 0 where it is silent.
Sampled: the same with (x~+ - x~)/Ts in place of x~', A = (Ad - I)/Ts, L and Gamma per second (delta form).
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.dissipation import Inequality, quadratic
from undeadzone.errors import InputError
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats, array, matrix, vector


class Dynamics(NamedTuple):
    """A (vertices, each n x n; delta form if Ts), C (p x n), L (n x p), gamma (2p x 2p, [right, left] per output), Ts [s]."""

    A: tuple[Floats, ...]
    C: Floats
    L: Floats
    gamma: Floats
    Ts: float | None

    @property
    def steps(self) -> list[Floats]:
        """Ts S Gamma S' (p x p) for the side patterns that are not dominated by another; one zero matrix if continuous."""
        p = self.C.shape[0]
        if self.Ts is None:
            return [np.zeros((p, p))]
        if not (self.gamma - np.diag(np.diag(self.gamma))).any():
            return [self.Ts * np.diag(np.diag(self.gamma).reshape(p, 2).max(axis=1))]
        patterns = (pattern(sides) for sides in itertools.product((1, -1), repeat=p))
        return [self.Ts * S @ self.gamma @ S.T for S in patterns]

    @property
    def groups(self) -> Floats:
        """Z (p x groups): outputs that Gamma couples must share their weight, W = Z w."""
        p = self.C.shape[0]
        linked = (np.abs(self.gamma).reshape(p, 2, p, 2).sum(axis=(1, 3)) > 0) | np.eye(
            p, dtype=bool
        )
        reach = np.linalg.matrix_power(linked.astype(int), p) > 0
        return np.unique(reach, axis=0).T.astype(float)

    def inequality(self, W: Floats) -> Inequality:
        """V' < 0 for V = x~'P x~ + d~'(W Gamma^-1) d~, in (x~, e): affine in W and in the P that it is given."""
        return self.extended(W, np.zeros((self.L.shape[0], 0)), [])

    def extended(
        self, W: Floats, E: Floats, terms: list[tuple[int, int, Floats]], decay: float = 0.0
    ) -> Inequality:
        """`inequality` of x~' = A x~ - L e + E w with more terms in (x~, e, w); see `dissipation.quadratic`."""
        n, p = self.L.shape
        pairs = []
        for step in self.steps:
            own = [
                (0, 1, self.C.T * W),
                (1, 1, -2 * np.diag(W)),
                (1, 1, (W[:, None] * step + W * step) / 2),
            ]
            pairs.append(quadratic([n, p, E.shape[1]], own + terms))
        supply, size = zip(*pairs, strict=True)
        return Inequality(self.A, np.hstack([-self.L, E]), supply, size, self.Ts, decay)


class Storage(NamedTuple):
    """V = x~'P x~ + d~'R d~ with P (n x n) and R = W Gamma^-1, W (p) once per edge."""

    P: Floats
    W: Floats
    gamma: Floats

    @property
    def R(self) -> Floats:
        """The weight (2p x 2p) of the width errors; 0 where a width is not adapted."""
        adapted = np.ix_(*2 * (np.diag(self.gamma) > 0,))
        R = np.zeros_like(self.gamma)
        R[adapted] = np.linalg.inv(self.gamma[adapted])
        return np.asarray(np.repeat(self.W, 2)[:, None] * R)

    def value(self, x_error: Floats, d_error: Floats) -> Floats:
        """V along errors x - x^ (N x n) and d - d^ (N x 2p, [right, left] of each output)."""
        return np.einsum("ki,ij,kj->k", x_error, self.P, x_error) + np.einsum(
            "ki,ij,kj->k", d_error, self.R, d_error
        )


def dynamics(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None) -> Dynamics:
    """The error dynamics of a model (n states, p outputs) for gains L (n x p) and gamma (see `adaptation`), both [1/s]."""
    n, p = linear.A.shape[0], linear.C.shape[0]
    return Dynamics(
        (delta(linear, Ts),),
        linear.C,
        matrix("L", L, n, p, "states x outputs"),
        adaptation(gamma, p),
        Ts,
    )


def delta(linear: Matrices, Ts: float | None) -> Floats:
    """A, or (Ad - I) / Ts for a sampled model: the matrix that tends to A as Ts -> 0."""
    A = linear.A
    return A if Ts is None else (A - np.eye(A.shape[0])) / Ts


def growth(A: Floats, Ts: float | None) -> float:
    """The largest growth rate [1/s] of x' = A x, or of x+ = x + Ts A x as (|z| - 1) / Ts."""
    poles = np.linalg.eigvals(A)
    return float(poles.real.max() if Ts is None else (np.abs(1 + Ts * poles).max() - 1) / Ts)


def adaptation(gamma: Floats, p: int) -> Floats:
    """Gamma (2p x 2p) from one number, one per output (p), one per edge (p x 2), or itself. Raises InputError, ShapeError."""
    found = array("gamma", gamma)
    if found.ndim == 2 and found.shape == (2 * p, 2 * p):
        if not np.allclose(found, found.T) or np.linalg.eigvalsh(found)[0] <= 0:
            raise InputError("gamma: a full matrix must be symmetric and positive definite")
        return found
    found = (
        np.repeat(vector("gamma", found, p, "one per output"), 2)
        if found.ndim < 2
        else matrix("gamma", found, p, 2, "[right, left] per output").ravel()
    )
    if (found < 0).any():
        raise InputError(f"gamma: must not be negative, found {found.min():g}")
    return np.diag(found)


def pattern(sides: tuple[int, ...]) -> Floats:
    """S (p x 2p) of the sides read (+1, 0, -1 per output): C x~ - S d~ is the innovation on them."""
    S = np.zeros((len(sides), 2 * len(sides)))
    for i, side in enumerate(sides):
        if side:
            S[i, 2 * i + (side < 0)] = side
    return S


class Scaling(NamedTuple):
    """Powers of two, so that nothing is rounded: x = state x_scaled, e = output e_scaled, t = time t_scaled."""

    state: Floats
    output: Floats
    time: float

    def dynamics(self, given: Dynamics) -> Dynamics:
        """The same dynamics in scaled quantities."""
        x, y, t = self
        return Dynamics(
            tuple(t * A * x / x[:, None] for A in given.A),
            given.C * x / y[:, None],
            t * given.L * y / x[:, None],
            t * given.gamma,
            None if given.Ts is None else given.Ts / t,
        )

    def storage(self, P: Floats) -> Floats:
        """P in original quantities."""
        return np.asarray(self.time * P / np.outer(self.state, self.state))

    def weights(self, W: Floats) -> Floats:
        """W in original quantities."""
        return W / self.output**2


def balance(given: Dynamics) -> Scaling:
    """The scaling under which x~ and e, driven by each other through L and C, have matrices of balanced rows and columns.

    Outputs that share a weight keep a common unit.
    """
    from scipy.linalg import matrix_balance

    A = np.mean(given.A, axis=0)
    n, p = A.shape[0], given.C.shape[0]
    time = 2.0 ** -np.round(np.log2(max(np.abs(np.linalg.eigvals(A)).max(), 1e-300)))
    _, (scale, _) = matrix_balance(
        np.block([[time * A, time * given.L], [given.C, np.eye(p)]]), permute=False, separate=True
    )
    leaders = np.argmax(given.groups, axis=0)
    return Scaling(scale[:n], given.groups @ scale[n:][leaders], float(time))
