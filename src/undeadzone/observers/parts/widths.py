"""Initial widths and their bound, as every adaptive observer takes them."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Array, Floats, array, matrix, vector


def pairs(key: str, value: Array, p: int) -> Floats:
    """(p x 2) of [right, left] from one number, one pair, or one pair per output. Raises ShapeError."""
    found = array(key, value)
    if found.ndim < 2 and found.size in (1, 2):
        return np.broadcast_to(found, (p, 2)).astype(float)
    return matrix(key, found, p, 2, "one [right, left] per output")


def bounded_widths(widths0: Array, width_max: Array | None, p: int) -> tuple[Floats, Floats]:
    """(d^(0) (p x 2), its upper bound d_M (p), inf if none is given). Raises InputError, ShapeError."""
    limit = (
        np.full(p, np.inf)
        if width_max is None
        else vector("observer.width_max", width_max, p, "one per output")
    )
    if (limit <= 0).any():
        raise InputError(f"observer.width_max: must be positive, found {limit.min():g}")
    widths = pairs("observer.widths0", widths0, p)
    if (widths < 0).any() or (widths > limit[:, None]).any():
        raise InputError(
            f"observer.widths0: must lie in [0, width_max], found {widths.tolist()} with width_max {limit.tolist()}"
        )
    return widths, limit
