"""Initial widths and their bound, as every adaptive observer takes them."""

from __future__ import annotations

import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Array, Floats, array, matrix, vector


def pairs(key: str, value: Array, p: int) -> Floats:
    """(p x 2) of [right, left] from one number, one pair, or one pair per output.

    Raises ShapeError that names the key.
    """
    numbers = array(key, value)
    if numbers.ndim < 2 and numbers.size in (1, 2):
        return np.broadcast_to(numbers, (p, 2)).astype(float)
    return matrix(key, numbers, p, 2, "one [right, left] per output")


def bounded_widths(widths0: Array, width_max: Array | None, p: int) -> tuple[Floats, Floats]:
    """Initial widths and their upper bound.

    Args:
        widths0: d^(0), one number, [right, left], or one such pair per output [z].
        width_max: d_M, one or one per output [z]; None: there is none.
        p: number of outputs.

    Returns:
        (d^(0) (p x 2), d_M (p), inf where there is none).

    Raises:
        InputError, ShapeError: unless 0 <= d^(0) <= d_M and d_M > 0.
    """
    if width_max is None:
        limit = np.full(p, np.inf)
    else:
        limit = vector("observer.width_max", width_max, p, "one per output")
    if (limit <= 0).any():
        raise InputError(f"observer.width_max: must be positive, found {limit.min():g}")
    widths = pairs("observer.widths0", widths0, p)
    if (widths < 0).any() or (widths > limit[:, None]).any():
        raise InputError(
            f"observer.widths0: must lie in [0, width_max], found {widths.tolist()} "
            f"with width_max {limit.tolist()}"
        )
    return widths, limit
