"""What is known of x(0) and of centres before the first reading, as rows of information."""

from __future__ import annotations

import numpy as np

from undeadzone.support.arrays import Floats


def beforehand(
    n: int, p: int, start_std: Floats | None, centre_std: Floats | None, least: float
) -> Floats:
    """Rows (k x n + 2p) on [x(0); d] whose squares are the information known beforehand.

    Args:
        n: number of states.
        p: number of outputs.
        start_std: standard deviations of x(0), infinite where it is not known (n); None: unknown.
        centre_std: those of each d_r - d_l (p), infinite where it is not known; None: unknown.
        least: deviation of a centre that is known exactly [z].
    """
    rows = []
    if start_std is not None:
        for i in np.flatnonzero(np.isfinite(start_std) & (start_std > 0)):
            rows.append(np.eye(n + 2 * p)[i] / start_std[i])
    if centre_std is not None:
        for i in np.flatnonzero(np.isfinite(centre_std)):
            right = n + 2 * i
            row = np.eye(n + 2 * p)[right] - np.eye(n + 2 * p)[right + 1]
            rows.append(row / max(float(centre_std[i]), least))
    return np.array(rows).reshape(len(rows), n + 2 * p)
