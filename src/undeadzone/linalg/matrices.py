"""Linear systems as matrices, x' = A x + B u, z = C x, and the scale of each state.

The scale distinguishes small values from values in a small unit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.util.arrays import LARGEST, Floats


class Matrices(NamedTuple):
    """Linear system x' = A x + B u (or x+ = ... when sampled), z = C x.

    Attributes:
        A: (n x n).
        B: (n x m).
        C: (p x n).
    """

    A: Floats
    B: Floats
    C: Floats

    @property
    def dual(self) -> Matrices:
        """Return (A', C', B'), whose state feedbacks are the observers' gains, transposed."""
        return Matrices(self.A.T, self.C.T, self.B.T)


def delta_form(linear: Matrices, Ts: float | None) -> Matrices:
    """Return the matrices in delta form, (Ad - I) / Ts and Bd / Ts, with limits A and B as Ts
    -> 0.

    Args:
        linear: a linear system (of one step if sampled).
        Ts: sample time [s] (None in continuous time, which leaves all unchanged).
    """
    if Ts is None:
        return linear
    A, B, C = linear
    return Matrices((A - np.eye(A.shape[0])) / Ts, B / Ts, C)


def symmetric_part(M: Floats) -> Floats:
    """Return (M + M') / 2 (n x n)."""
    return np.asarray((M + M.T) / 2)


def spectral_radius(A: Floats) -> float:
    """Return the largest size of an eigenvalue of a matrix (n x n)."""
    return float(np.abs(np.linalg.eigvals(A)).max())


def scale_states(A: Floats, unit: Floats) -> Floats:
    """Return A for states in other units (n x n).

    Args:
        A: (n x n).
        unit: of each state (n).
    """
    return A * unit / unit[:, None]


def companion_form(a: Any, b: Any = (1.0,)) -> Matrices:
    """Return the companion form (15): A with last row -a, B = e_n, C = [b_0, b_1, ...].

    Args:
        a: coefficients of the denominator without the leading 1 (n), lowest first.
        b: coefficients of the numerator (at most n), lowest first.
    """
    a = np.atleast_1d(a)
    b = np.atleast_1d(b)
    n = a.size
    A = np.eye(n, k=1)
    A[-1] = -a
    return Matrices(A, np.eye(n)[:, -1:], np.pad(b, (0, n - b.size))[None, :])


def state_response_sizes(A: Floats, B: Floats, omega: float = 0.0) -> Floats:
    """Return the size of each state of x' = A x + B u under a unit input near a frequency (n).

    In these units a plant does not depend on its unit of time or on the units of its states. States
    that B does not reach get the least size of the others.

    Args:
        A: (n x n).
        B: (n x m).
        omega: the frequency [rad/s] (0: near the poles of A).

    Returns:
        The sizes (n).
    """
    rate = omega or spectral_radius(A) or float(np.abs(A).max()) or 1.0
    resolvent = (1 + 1j) * rate * np.eye(A.shape[0]) - A
    size = np.linalg.norm(np.linalg.solve(resolvent, B.astype(complex)), axis=1)
    if not (np.isfinite(size).all() and size.any()):
        return np.ones_like(size)
    reached = np.maximum(size, size.max() / LARGEST**2)
    return np.where(size > 0, reached, reached[size > 0].min())


def balance_states(A: Floats) -> Floats:
    """Return units of the states of x' = A x, powers of two, that balance rows and columns of
    A.

    LAPACK's gebal (Parlett and Reinsch 1969). All units are 1 unless A is finite.

    References:
        B. N. Parlett, C. Reinsch (1969), doi:10.1007/BF02165404
    """
    from scipy.linalg import matrix_balance

    if not np.isfinite(A).all():
        return np.ones(A.shape[0])
    _, (units, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(units)


def change_state_units(A: Floats, units: Floats) -> Floats:
    """Return the matrix of x' = A x for states measured in the given units (n)."""
    return A / units[:, None] * units


def feedback_loops(A: Floats) -> Floats:
    """Return A without the entries that are in no loop of states, with the poles of A (n x n).

    The other entries, such as x_1' = x_2 of an integrator, have units of their own.
    """
    n = A.shape[0]
    linked = (A != 0) | np.eye(n, dtype=bool)
    reach = np.linalg.matrix_power(linked.astype(float), n) > 0
    return np.where(reach & reach.T, A, 0.0)
