"""Play (backlash) ahead of a sensor: what turns back must first cross the gap.

The reading holds while z moves inside the gap: -c_l <= z - y / m <= c_r. It is z - c_r while z
moves right in contact, z + c_l while it moves left; d_r, d_l stand for c_r, c_l (docs/play.md).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from undeadzone.support.arrays import Floats

SHARE = 0.16  # of a quarter period of the plant: over which motion is judged by default
FEWEST = 4  # readings over which motion is judged at least
FALSE_ALARMS = 1e-6  # rate at which noise may pass for motion by default, in poles of the plant


def held(ops: Any, z: Any, before: Any, right: Any, left: Any) -> Any:
    """What is read of z, in units of z: the level before, moved as little as the gap allows.

    Args:
        ops: the module of fmax and fmin, NumPy or CasADi.
        z: true output.
        before: the level before.
        right, left: gaps c_r, c_l [z].
    """
    return ops.fmax(ops.fmin(before, z + left), z - right)


def contact(level: Any, before: Any) -> Any:
    """The contact in which a level moved: +1 right, -1 left, 0 where it held."""
    return 1.0 * (level > before) - 1.0 * (level < before)


def levels(z: Floats, right: Floats, left: Floats, start: Floats | None = None) -> Floats:
    """What is behind a play along a record of outputs (N x p) [z].

    Args:
        z: true outputs (N x p).
        right, left: gaps (p) [z].
        start: level before the first sample (p) [z]; None: the nearest possible to 0.
    """
    level = np.zeros(z.shape[1]) if start is None else start
    along = np.empty_like(z)
    for k, now in enumerate(z):
        level = held(np, now, level, right, left)
        along[k] = level
    return along


def contacts(z: Floats, right: Floats, left: Floats, start: Floats | None = None) -> Floats:
    """The contacts along a record of outputs (N x p), at the first sample those of the start.

    Args:
        z, right, left, start: as of `levels`.
    """
    first = np.zeros(z.shape[1]) if start is None else start
    along = levels(z, right, left, first)
    return contact(along, np.vstack([first, along[:-1]]))


def readings_of_motion(step: float, pace: float) -> int:
    """How many readings motion is judged over by default.

    Args:
        step: time between readings [s].
        pace: how fast the plant moves [1/s].
    """
    return max(FEWEST, round(SHARE * np.pi / 2 / pace / step))
