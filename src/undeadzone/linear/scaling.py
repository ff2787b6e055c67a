"""The scale of each state, so that what is small is told from what is in a small unit."""

from __future__ import annotations

import numpy as np

from undeadzone.support.arrays import LARGEST, Floats


def sizes(A: Floats, B: Floats, omega: float = 0.0) -> Floats:
    """How large each state (n) of x' = A x + B u is under a unit input near omega [rad/s] (0: near the poles of A).

    In these units plants differ by neither their unit of time nor those of their states. States that B does not reach
    get the least size of the others.
    """
    rate = omega or float(np.abs(np.linalg.eigvals(A)).max()) or float(np.abs(A).max()) or 1.0
    found = np.linalg.norm(
        np.linalg.solve((1 + 1j) * rate * np.eye(A.shape[0]) - A, B.astype(complex)), axis=1
    )
    if not (np.isfinite(found).all() and found.any()):
        return np.ones_like(found)
    reached = np.maximum(found, found.max() / LARGEST**2)
    return np.where(found > 0, reached, reached[found > 0].min())
