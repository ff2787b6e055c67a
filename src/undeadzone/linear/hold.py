"""From continuous to sampled time, exactly: zero-order hold, and the covariance that white noise leaves in a step."""

from __future__ import annotations

import numpy as np

from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats


def zoh(linear: Matrices, Ts: float) -> Matrices:
    """Exact zero-order hold: Ad = e^{A Ts}, Bd = int_0^Ts e^{A t} dt B, C unchanged."""
    from scipy.linalg import expm

    n, m = linear.B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = linear.A, linear.B
    both = expm(block * Ts)
    return Matrices(both[:n, :n], both[:n, n:], linear.C)


def sampled_noise(A: Floats, W: Floats, Ts: float) -> tuple[Floats, Floats]:
    """(e^{A Ts}, the covariance that white noise of density W (n x n) per second adds to x' = A x + w over Ts [s]), van Loan (1978)."""
    from scipy.linalg import expm

    n = A.shape[0]
    both = expm(np.block([[-A, W], [np.zeros((n, n)), A.T]]) * Ts)
    Ad = both[n:, n:].T
    return Ad, Ad @ both[:n, n:]
