"""Exact discretisation: zero-order hold, its derivatives, and the noise of a step.

Matrices are balanced first: a plant in an odd unit of time has entries that are far apart, and the
exponential of such a matrix loses digits, its derivative all of them. In a batch of plants, the
bits of each do not depend on the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.matrices import Matrices, balance_states, change_state_units
from undeadzone.util.arrays import Floats
from undeadzone.util.installed import import_scipy

TERMS = 12  # of the series, whose rest is below 1e-17 for a norm of at most SMALL
SMALL = 0.25


def zoh(linear: Matrices, Ts: float) -> Matrices:
    """Return the exact zero-order hold:

    Ad = e^(A Ts), Bd = int_0^Ts e^(A t) dt B, C unchanged.

    Args:
        linear: the plant in continuous time.
        Ts: time for which u is held [s].
    """
    import_scipy()
    from scipy.linalg import expm

    n = linear.A.shape[0]
    block = _augment_inputs(linear.A, linear.B) * Ts
    units = _balancing_units(block, n)
    both = change_state_units(expm(change_state_units(block, units)), 1 / units)
    return Matrices(both[:n, :n], both[:n, n:], linear.C)


def undo_zoh(sampled: Matrices, Ts: float) -> Matrices:
    """Return the plant in continuous time whose zero-order hold is the given one.

    Poles beyond the Nyquist frequency are mapped below it, as no sampled plant contains them.

    Args:
        sampled: Ad, Bd, C.
        Ts: time for which u is held [s].

    Raises:
        InputError: a pole that no such plant has: at 0 (a delay), or negative and real.
    """
    from scipy.linalg import logm

    n, m = sampled.B.shape
    poles = np.linalg.eigvals(sampled.A)
    is_real = np.abs(poles.imag) < 1e-9 * np.maximum(np.abs(poles), 1e-12)
    if np.any(np.abs(poles) < 1e-6):
        raise InputError(
            "plant: a sampled pole lies at 0, a delay, which a plant in continuous time with these "
            "states does not have"
        )
    negative = poles.real[is_real & (poles.real < 0)]
    if negative.size:
        raise InputError(
            f"plant: a sampled pole lies at {negative[0]:.3g}, and no plant in continuous time has "
            "a negative real one"
        )
    block = np.eye(n + m)
    block[:n, :n] = sampled.A
    block[:n, n:] = sampled.B
    both = np.real(logm(block)) / Ts
    return Matrices(both[:n, :n], both[:n, n:], sampled.C)


def zoh_slopes(AB: Floats, directions: Sequence[Floats], Ts: float) -> Floats:
    """Return d[Ad, Bd] of `zoh` along directions, stacked by rows (K n x (n + m)).

    Args:
        AB: [A, B] (n x (n + m)).
        directions: d[A, B] (K of n x (n + m)).
        Ts: time for which u is held [s].
    """
    from scipy.linalg import expm_frechet

    n, columns = AB.shape
    block = _augment_inputs(AB[:, :n], AB[:, n:]) * Ts
    units = _balancing_units(block, n)
    even = change_state_units(block, units)
    slopes: list[Floats] = [np.zeros((0, columns))]
    for direction in directions:
        change = change_state_units(_augment_inputs(direction[:, :n], direction[:, n:]) * Ts, units)
        slope = expm_frechet(even, change, compute_expm=False)
        slopes.append(change_state_units(slope, 1 / units)[:n])
    return np.concatenate(slopes)


def discretise_noise(A: Floats, W: Floats, Ts: float) -> tuple[Floats, Floats]:
    """Return e^(A Ts) and the covariance that white noise adds to x' = A x + w over a step.

    By van Loan (1978).

    His matrix holds e^(-A t), so that it is taken of a short part of the step, which is doubled.

    References:
        C. F. Van Loan (1978), doi:10.1109/TAC.1978.1101743

    Args:
        A: (n x n).
        W: density of w (n x n) per second.
        Ts: the step [s].

    Returns:
        e^{A Ts} and the covariance (n x n) that w adds.
    """
    from scipy.linalg import expm

    n = A.shape[0]
    units = balance_states(A)
    even = change_state_units(A, units)
    density = W / np.outer(units, units)
    size = _size_ratio(density, even)
    doublings = max(0, int(np.frexp(np.abs(even).sum(axis=1).max() * Ts)[1]))
    part = np.ldexp(Ts, -doublings)
    both = expm(np.block([[-even, density / size], [np.zeros((n, n)), even.T]]) * part)
    Ad = both[n:, n:].T
    covariance = Ad @ both[:n, n:]
    for _ in range(doublings):
        covariance = covariance + Ad @ covariance @ Ad.T
        Ad = Ad @ Ad
    return change_state_units(Ad, 1 / units), size * covariance * np.outer(units, units)


def _augment_inputs(A: Floats, B: Floats) -> Floats:
    """Return [[A, B], [0, 0]], the dynamics of `[x; u]` with constant u."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n] = A
    block[:n, n:] = B
    return block


def _balancing_units(block: Floats, n: int) -> Floats:
    """Return the units of `[x; u]` that balance `_augment_inputs`.

    A unit of u moves x as much as x itself.
    """
    A = block[:n, :n]
    B = block[:n, n:]
    of_states = balance_states(A)
    even = change_state_units(A, of_states)
    of_inputs = [1 / _size_ratio(b / of_states, even) for b in B.T]
    return np.concatenate([of_states, of_inputs])


def _size_ratio(M: Floats, A: Floats) -> float:
    """Return |M| / |A| as a power of two, or 1 if either is 0."""
    sizes = np.abs(M).max(initial=0.0), np.abs(A).max(initial=0.0)
    if not all(0 < size < np.inf for size in sizes):
        return 1.0
    return float(2.0 ** np.round(np.log2(sizes[0]) - np.log2(sizes[1])))


def zoh_of_each(AB: Floats, Ts: float) -> Floats:
    """Return the zero-order hold of many plants, as `zoh` of a single plant.

    X = [Ad - I, Bd] = (I + M / 2! + M^2 / 3! + ...) [A, B] Ts with M = A Ts over a fraction 2^-k of
    Ts, then k times X <- 2 X + (Ad - I) X, which loses nothing where Ad is close to I. Plain
    arithmetic on arrays, plants last: a matrix product of a library may round differently in
    another batch.

    Args:
        AB: [A, B] of each plant (n x (n + m) x count).
        Ts: time for which u is held [s].

    Returns:
        [Ad, Bd] (n x (n + m) x count).
    """
    n = AB.shape[0]
    step = AB * Ts
    norm = np.abs(step[:, :n]).sum(axis=1).max(axis=0)
    doublings = np.maximum(np.frexp(norm / SMALL)[1], 0)
    step = np.ldexp(step, -doublings)
    X = step
    for k in range(TERMS, 1, -1):
        X = step + _multiply_each(step[:, :n], X) / k
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(doublings.max(initial=0)):
            X = np.where(k < doublings, 2 * X + _multiply_each(X[:, :n], X), X)
    X[np.arange(n), np.arange(n)] += 1.0
    return X


def _multiply_each(M: Floats, X: Floats) -> Floats:
    """Return M X for every plant, summed in a fixed order."""
    total = M[:, 0, None] * X[None, 0]
    for k in range(1, M.shape[1]):
        total += M[:, k, None] * X[None, k]
    return total
