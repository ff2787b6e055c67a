"""What is said of the play ahead of a dead zone: two gaps, or the ranges that hold them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.support.arrays import Floats, array, shape_text

KEY = "sensor.play"


class Ahead(NamedTuple):
    """A checked play ahead of a dead zone.

    Attributes:
        right, left: gaps c_r, c_l, of a range its middle (p) [z].
        ranges: of all c_r, then of all c_l (2p x 2) [z]; None: the gaps are known.
        threshold: change of y over the window that counts as motion (p) [y].
    """

    right: Floats
    left: Floats
    ranges: Floats | None
    threshold: Floats


def largest_gap(play: Ahead | None) -> float:
    """The largest gap that a play may have [z]; 0 without one."""
    if play is None:
        return 0.0
    ends = np.stack([play.right, play.left]) if play.ranges is None else play.ranges
    return float(ends.max())


def gaps_of(given: Any, p: int, key: str = KEY) -> tuple[Floats, Floats | None]:
    """The gaps (2 x p) and, where they are not known, their ranges (2p x 2) [z].

    Args:
        given: [c_r, c_l], or one such pair per output; a range [lo, hi] in place of each number.
        p: number of outputs.
        key: named in errors.

    Raises:
        InputError: a gap below 0, a range that is none.
        ShapeError: another shape.
    """
    value = array(key, given)
    if value.shape in ((2,), (p, 2)) and not (value.shape == (2, 2) and p == 1):
        gaps = np.broadcast_to(value, (p, 2)).T
        if (gaps < 0).any():
            raise InputError(f"{key}: gaps must not be negative, found {value.tolist()}")
        return gaps.copy(), None
    if value.shape not in ((2, 2), (p, 2, 2)):
        raise ShapeError(
            f"{key}: expected [c_r, c_l], the gaps ahead of the dead zone, or one such pair per "
            f"output ({p} x 2); to an observer [[lo, hi], [lo, hi]], their ranges; found "
            f"{shape_text(value.shape) or 'one number'}"
        )
    ranges = np.broadcast_to(value, (p, 2, 2)).swapaxes(0, 1).reshape(2 * p, 2)
    if (ranges[:, 0] < 0).any() or (ranges[:, 0] >= ranges[:, 1]).any():
        raise InputError(f"{key}: a range [lo, hi] must have 0 <= lo < hi, found {value.tolist()}")
    return ranges.mean(axis=1).reshape(2, p), ranges
