"""Play (backlash) ahead of a sensor: what turns back must first cross the gap.

The reading holds while z moves inside the gap: -c_l <= z - y / m <= c_r. It is z - c_r while z
moves right in contact, z + c_l while it moves left; d_r, d_l stand for c_r, c_l (docs/play.md).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.util.arrays import Floats, describe_shape, require_array, require_ranges

KEY = "sensor.play"
SHARE = 0.16  # of a quarter period of the plant: over which motion is judged by default
FEWEST = 4  # readings over which motion is judged at least
CERTAIN = 0.02  # share of a quantum by which a tick is uncertain at least
FALSE_ALARMS = 1e-6  # rate at which noise may pass for motion by default, in poles of the plant


def apply_backlash(ops: Any, z: Any, before: Any, right: Any, left: Any) -> Any:
    """Return the reading in units of z: the level before, moved as little as the gap allows.

    Args:
        ops: the module of fmax and fmin, NumPy or CasADi.
        z: true output.
        before: the level before.
        right, left: gaps c_r, c_l [z].
    """
    return ops.fmax(ops.fmin(before, z + left), z - right)


def contact(level: Any, before: Any) -> Any:
    """Return the contact in which a level moved: +1 right, -1 left, 0 if it held."""
    return 1.0 * (level > before) - 1.0 * (level < before)


def levels(z: Floats, right: Floats, left: Floats, start: Floats) -> Floats:
    """Return the level of a play along a record of outputs (N x p) [z].

    Args:
        z: true outputs (N x p).
        right, left: gaps (p) [z].
        start: level before the first sample (p) [z].
    """
    return np.asarray(np.clip(start, *level_limits(z, right, left)))


def level_limits(z: Floats, right: Floats, left: Floats) -> Floats:
    """Return the lower and the upper limit of a level, whatever it was at first (2 x N x p) [z].

    Args:
        z, right, left: as of `levels`.
    """
    unread = np.isnan(z)  # where a level holds
    limits = np.stack([np.where(unread, -np.inf, z - right), np.where(unread, np.inf, z + left)])
    span = 1  # samples that limit a level together
    while (limits[0, span:] < limits[1, span:]).any():
        limits[:, span:] = np.clip(limits[:, :-span], *limits[:, span:])
        span *= 2
    return limits


def contacts(z: Floats, right: Floats, left: Floats, start: Floats) -> Floats:
    """Return the contacts along a record of outputs (N x p), at the first sample those of the
    start.

    Args:
        z, right, left, start: as of `levels`.
    """
    along = levels(z, right, left, start)
    return contact(along, np.vstack([start, along[:-1]]))


def detect_tick(ops: Any, y: Any, side: Any, moved: Any, quantum: Any) -> tuple[Any, Any]:
    """Return z, in units of y, at the time of an encoder's tick, and its variance.

    z has just passed the boundary between two multiples of the quantum, by at most how far it moves
    in a sample.

    Args:
        ops: the module of fmin and fabs, NumPy or CasADi.
        y: the reading.
        side: direction of the tick, -1 or +1.
        moved: how far z moves in a sample [y].
        quantum: of the encoder [y].
    """
    passed = ops.fmin(ops.fabs(moved), quantum)
    return y - side * (quantum - passed) / 2, passed**2 / 12 + (CERTAIN * quantum) ** 2


def readings_of_motion(step: float, pace: float) -> int:
    """Return the default number of readings over which motion is judged.

    Args:
        step: time between readings [s].
        pace: how fast the plant moves [1/s].
    """
    return max(FEWEST, round(SHARE * np.pi / 2 / pace / step))


# --- What is said of the play ahead of a dead zone: two gaps, or the ranges that hold them


class Ahead(NamedTuple):
    """A checked play ahead of a dead zone.

    Attributes:
        right, left: gaps c_r, c_l, of a range its middle (p) [z].
        ranges: of all c_r, then of all c_l (2p x 2) [z] (None: the gaps are known).
        threshold: change of y over the window that counts as motion (p) [y].
    """

    right: Floats
    left: Floats
    ranges: Floats | None
    threshold: Floats


def largest_gap(play: Ahead | None) -> float:
    """Return the largest gap that a play may have [z], or 0 without one."""
    if play is None:
        return 0.0
    ends = np.stack([play.right, play.left]) if play.ranges is None else play.ranges
    return float(ends.max())


def gaps_of(given: Any, p: int, key: str = KEY) -> tuple[Floats, Floats | None]:
    """Return the gaps (2 x p) and, if they are not known, their ranges (2p x 2) [z].

    Args:
        given: [c_r, c_l], or one such pair per output (a range [lo, hi] in place of each number).
        p: number of outputs.
        key: named in errors.

    Raises:
        InputError: a gap below 0, an invalid range.
        ShapeError: another shape.
    """
    value = require_array(key, given)
    if value.shape in ((2,), (p, 2)) and not (value.shape == (2, 2) and p == 1):
        gaps = np.broadcast_to(value, (p, 2)).T
        if (gaps < 0).any():
            raise InputError(f"{key}: gaps must not be negative, found {value.tolist()}")
        return gaps.copy(), None
    if value.shape not in ((2, 2), (p, 2, 2)):
        raise ShapeError(
            f"{key}: expected [c_r, c_l], the gaps ahead of the dead zone, or one such pair per "
            f"output ({p} x 2). To an observer [[lo, hi], [lo, hi]], their ranges, found "
            f"{describe_shape(value.shape)}"
        )
    ranges = np.broadcast_to(value, (p, 2, 2)).swapaxes(0, 1).reshape(2 * p, 2)
    require_ranges(key, ranges, value.tolist())
    return ranges.mean(axis=1).reshape(2, p), ranges
