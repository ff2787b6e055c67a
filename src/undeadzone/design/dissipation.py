"""The error dynamics as one object, the inequality V' + supply <= 0 as one matrix, and its proof by eigenvalues alone.

Errors obey x~' = A x~ - L e, d~' = Gamma S'e with the innovation e = theta (C x~ - S d~), 0 <= theta <= 1, where the
measured side fixes S: +1 at d_r of an output read on the right, -1 at d_l on the left, e = 0 where it is silent.
Sampled: the same with (x~+ - x~)/Ts in place of x~', A = (Ad - I)/Ts, L and Gamma per second (delta form).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.arrays import Floats, array, matrix, vector
from undeadzone.errors import InputError
from undeadzone.plant import Matrices


class Dynamics(NamedTuple):
    """Error dynamics: A (vertices, each n x n, delta form if Ts), C (p x n), L (n x p), gamma (2p x 2p, [right, left] per output)."""

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
        """Z (p x groups): outputs that Gamma couples must share their weight, W = diag(Z w)."""
        p = self.C.shape[0]
        linked = (np.abs(self.gamma).reshape(p, 2, p, 2).sum(axis=(1, 3)) > 0) | np.eye(p, dtype=bool)
        reach = np.linalg.matrix_power(linked.astype(int), p) > 0
        return np.unique(reach, axis=0).T.astype(float)


def dynamics(linear: Matrices, L: Floats, gamma: Floats, Ts: float | None) -> Dynamics:
    """The error dynamics of a model (n states, p outputs) for gains L (n x p) and gamma (see `adaptation`), both [1/s]."""
    n, p = linear.A.shape[0], linear.C.shape[0]
    return Dynamics((delta(linear, Ts),), linear.C, matrix("L", L, n, p, "states x outputs"), adaptation(gamma, p), Ts)


def delta(linear: Matrices, Ts: float | None) -> Floats:
    """A, or (Ad - I) / Ts for a sampled model: the matrix that tends to A as Ts -> 0."""
    A = linear.A
    return A if Ts is None else (A - np.eye(A.shape[0])) / Ts


def adaptation(gamma: Floats, p: int) -> Floats:
    """Gamma (2p x 2p) from one number, one per output (p), one per edge (p x 2), or itself. Raises InputError, ShapeError."""
    found = array("gamma", gamma)
    if found.ndim == 2 and found.shape == (2 * p, 2 * p):
        if not np.allclose(found, found.T) or np.linalg.eigvalsh(found)[0] <= 0:
            raise InputError("gamma: a full matrix must be symmetric and positive definite")
        return found
    found = np.repeat(vector("gamma", found, p, "one per output"), 2) if found.ndim < 2 else matrix("gamma", found, p, 2, "[right, left] per output").ravel()
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


def dissipation(P: Floats, A: Floats, inputs: Floats, supply: Floats, Ts: float | None) -> Floats:
    """The matrix of V' + supply in (x, b) for x' = A x + inputs b, V = x'Px; it must not be positive anywhere.

    Sampled, V' stands for (V+ - V)/Ts; its square term is bordered, [[., sqrt(Ts) F'P], [., -P]] with F = [A, inputs].
    """
    n = A.shape[0]
    PF = P @ np.hstack([A, inputs])
    top = supply.copy()
    top[:n] += PF
    top[:, :n] += PF.T
    if Ts is None:
        return top
    border = np.sqrt(Ts) * PF.T
    return np.block([[top, border], [border.T, -P]])


def passivity(C: Floats, W: Floats, step: Floats) -> Floats:
    """The supply 2 e'W (C x~ - e) + e'W step e of the width errors, in (x~, e)."""
    n = C.shape[1]
    corner = -2 * np.diag(W) + W[:, None] * step
    return np.block([[np.zeros((n, n)), C.T * W], [(C.T * W).T, (corner + corner.T) / 2]])


class Scaling(NamedTuple):
    """Powers of two: x = state x_scaled, e = output e_scaled, t = time t_scaled."""

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


def balance(given: Dynamics) -> Scaling:
    """The scaling under which x~ and e, driven by each other through L and C, have matrices of balanced rows and columns.

    Outputs that share a weight keep a common unit.
    """
    from scipy.linalg import matrix_balance

    A = np.mean(given.A, axis=0)
    n, p = A.shape[0], given.C.shape[0]
    size = max(np.linalg.norm(A, 2), 1e-300)
    time = 2.0 ** -np.round(np.log2(size))
    _, (scale, _) = matrix_balance(np.block([[time * A, time * given.L], [given.C, np.eye(p)]]), permute=False, separate=True)
    leaders = np.argmax(given.groups, axis=0)
    output = given.groups @ scale[n:][leaders]
    return Scaling(scale[:n], output, float(time))


class Check(NamedTuple):
    """proved: the matrices are definite beyond rounding. lmi: greatest eigenvalue of the inequality, scaled to a diagonal of -1;
    P: least eigenvalue of P, scaled to a unit diagonal; rounding: how far both must stay from 0."""

    proved: bool
    lmi: float
    P: float
    rounding: float


def proved(P: Floats, inequality: Callable[[bool], list[Floats]]) -> Check:
    """Whether P > 0 and every matrix of the inequality is negative definite, by eigenvalues and a bound on their rounding.

    inequality(False) gives the matrices; inequality(True) the same sums with every term replaced by its absolute value,
    from which the rounding of each entry is bounded.
    """
    checks = [_definite(P, np.abs(P))]
    checks += [_definite(-found, size) for found, size in zip(inequality(False), inequality(True), strict=True)]
    least = min(check[0] for check in checks[1:])
    return Check(all(value > slack for value, slack in checks), -least, checks[0][0], max(slack for _, slack in checks))


def _definite(M: Floats, size: Floats) -> tuple[float, float]:
    """(least eigenvalue of M scaled to a unit diagonal, bound on its rounding); -inf if a diagonal entry is not positive."""
    diagonal = np.diag(M)
    if not np.isfinite(M).all() or (diagonal <= 0).any():
        return -np.inf, 0.0
    scale = 1 / np.sqrt(np.outer(diagonal, diagonal))
    rounding = 4 * (M.shape[0] + 4) * np.finfo(float).eps * (np.linalg.norm(size * scale) + M.shape[0])
    return float(np.linalg.eigvalsh((M + M.T) / 2 * scale)[0]), float(rounding)
