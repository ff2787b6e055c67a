"""From continuous to sampled time, exactly: zero-order hold, its slopes, and the noise of a step.

Matrices are balanced first: a plant in an odd unit of time has entries that are far apart, and the
exponential of such a matrix loses digits, its derivative all of them.
"""

from __future__ import annotations

import numpy as np

from undeadzone.linear.matrices import Matrices
from undeadzone.linear.scaling import balancing, similar
from undeadzone.support.arrays import Floats


def zoh(linear: Matrices, Ts: float) -> Matrices:
    """Exact zero-order hold: Ad = e^{A Ts}, Bd = int_0^Ts e^{A t} dt B, C unchanged.

    Args:
        linear: the plant in continuous time.
        Ts: time for which u is held [s].
    """
    from scipy.linalg import expm

    n = linear.A.shape[0]
    block = _with_inputs(linear.A, linear.B) * Ts
    units = _units(block, n)
    both = similar(expm(similar(block, units)), 1 / units)
    return Matrices(both[:n, :n], both[:n, n:], linear.C)


def zoh_slopes(AB: Floats, directions: list[Floats], Ts: float) -> Floats:
    """d[Ad, Bd] of `zoh` along directions, one below the other (K n x (n + m)).

    Args:
        AB: [A, B] (n x (n + m)).
        directions: d[A, B] (K of n x (n + m)).
        Ts: time for which u is held [s].
    """
    from scipy.linalg import expm_frechet

    n, columns = AB.shape
    block = _with_inputs(AB[:, :n], AB[:, n:]) * Ts
    units = _units(block, n)
    even = similar(block, units)
    slopes = [np.zeros((0, columns))]
    for direction in directions:
        change = similar(_with_inputs(direction[:, :n], direction[:, n:]) * Ts, units)
        slope = expm_frechet(even, change, compute_expm=False)
        slopes.append(similar(slope, 1 / units)[:n])
    return np.concatenate(slopes)


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
    units = balancing(A)
    even, density = similar(A, units), W / np.outer(units, units)
    size = _ratio(density, even)
    both = expm(np.block([[-even, density / size], [np.zeros((n, n)), even.T]]) * Ts)
    Ad = both[n:, n:].T
    covariance = size * (Ad @ both[:n, n:])
    return similar(Ad, 1 / units), covariance * np.outer(units, units)


def _with_inputs(A: Floats, B: Floats) -> Floats:
    """[[A, B], [0, 0]], the motion of [x; u] with u held."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    return block


def _units(block: Floats, n: int) -> Floats:
    """The units of [x; u] that balance `_with_inputs`; a unit of u moves x as much as x itself."""
    A, B = block[:n, :n], block[:n, n:]
    of_states = balancing(A)
    even = similar(A, of_states)
    of_inputs = [1 / _ratio(b / of_states, even) for b in B.T]
    return np.concatenate([of_states, of_inputs])


def _ratio(M: Floats, A: Floats) -> float:
    """|M| / |A| as a power of two; 1 where either is 0."""
    sizes = np.abs(M).max(initial=0.0), np.abs(A).max(initial=0.0)
    if not all(0 < size < np.inf for size in sizes):
        return 1.0
    return float(2.0 ** np.round(np.log2(sizes[0]) - np.log2(sizes[1])))
