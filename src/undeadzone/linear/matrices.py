"""Linear systems as matrices: x' = A x + B u, z = C x."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.support.arrays import Floats


class Matrices(NamedTuple):
    """A linear system x' = A x + B u (or x+ = ... when sampled), z = C x.

    Attributes:
        A: (n x n).
        B: (n x m).
        C: (p x n).
    """

    A: Floats
    B: Floats
    C: Floats


def companion(a: Any, b: Any = (1.0,)) -> Matrices:
    """Companion form (15): A with last row -a, B = e_n, C = [b_0, b_1, ...].

    Args:
        a: coefficients of the denominator without the leading 1 (n), lowest first.
        b: coefficients of the numerator (at most n), lowest first.
    """
    a, b = np.atleast_1d(a), np.atleast_1d(b)
    n = a.size
    A = np.eye(n, k=1)
    A[-1] = -a
    return Matrices(A, np.eye(n)[:, -1:], np.pad(b, (0, n - b.size))[None, :])
