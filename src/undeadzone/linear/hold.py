"""From continuous to sampled time, exactly: zero-order hold, and the noise of a step."""

from __future__ import annotations

import numpy as np

from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats


def zoh(linear: Matrices, Ts: float) -> Matrices:
    """Exact zero-order hold: Ad = e^{A Ts}, Bd = int_0^Ts e^{A t} dt B, C unchanged.

    Args:
        linear: the plant in continuous time.
        Ts: time for which u is held [s].
    """
    from scipy.linalg import expm

    n, m = linear.B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = linear.A, linear.B
    both = expm(block * Ts)
    return Matrices(both[:n, :n], both[:n, n:], linear.C)


def sampled_noise(A: Floats, W: Floats, Ts: float) -> tuple[Floats, Floats]:
    """What white noise w adds to the state of x' = A x + w over a step, van Loan (1978).

    Args:
        A: (n x n).
        W: density of w (n x n) per second.
        Ts: the step [s].

    Returns:
        e^{A Ts} and the covariance (n x n) that w adds.
    """
    from scipy.linalg import expm

    n = A.shape[0]
    both = expm(np.block([[-A, W], [np.zeros((n, n)), A.T]]) * Ts)
    Ad = both[n:, n:].T
    return Ad, Ad @ both[:n, n:]
