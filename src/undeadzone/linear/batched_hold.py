"""The exact zero-order hold of many linear plants at once.

Each plant gets the same bits whatever the others are.
"""

from __future__ import annotations

import numpy as np

from undeadzone.support.arrays import Floats

TERMS = 12  # of the series, whose rest is below 1e-17 for a norm of at most SMALL
SMALL = 0.25


def zoh(AB: Floats, Ts: float) -> Floats:
    """Zero-order hold of many plants; as `hold.zoh` of one.

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
        X = step + _product(step[:, :n], X) / k
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(doublings.max(initial=0)):
            X = np.where(k < doublings, 2 * X + _product(X[:, :n], X), X)
    X[np.arange(n), np.arange(n)] += 1.0
    return X


def _product(M: Floats, X: Floats) -> Floats:
    """M X for every plant, summed in one order."""
    total = M[:, 0, None] * X[None, 0]
    for k in range(1, M.shape[1]):
        total += M[:, k, None] * X[None, k]
    return total
