"""The range of a reading: y stays within [lo, hi], and at a limit it only bounds the output.

Functions of a reading take NumPy arrays or CasADi expressions alike. Pairs of numbers that a user
gives, one or one for each, are checked here for all of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.util.arrays import LARGEST, Floats, describe_shape

ROUNDING = 1e-6  # share of a limit by which a reading at it may miss it: of floats and text


class Limits(NamedTuple):
    """The limits of the readings; those that do not exist are `LARGEST`.

    Attributes:
        low, high: least and largest reading (p) [y].
    """

    low: Any
    high: Any


def at_limit(y: Any, limits: Limits) -> Any:
    """Return +1 if a reading is at its upper limit, -1 if at its lower one, else 0 (NaN too)."""
    low = (1 - ROUNDING) * limits.low
    high = (1 - ROUNDING) * limits.high
    return 1.0 * (y >= high) - 1.0 * (y <= low)


def is_beyond_range(y: Any, limits: Limits) -> Any:
    """Return 1 if a finite number lies beyond its range by more than rounding: no reading does."""
    low = (1 + ROUNDING) * limits.low
    high = (1 + ROUNDING) * limits.high
    return 1.0 * (y > high) * (y < np.inf) + 1.0 * (y < low) * (y > -np.inf)


def require_range(key: str, value: Any, p: int) -> tuple[Floats, Floats]:
    """Return (least, largest) readings (p each), -inf and inf if there is no limit.

    Args:
        key: named in errors.
        value: [lo, hi], or one such pair per output (p x 2); None: no limits.
        p: number of outputs.

    Raises:
        InputError: unless lo < 0 < hi; -inf and inf are no limits.
        ShapeError: another shape.
    """
    low, high = pairs(key, value, p, [-np.inf, np.inf], "[lo, hi]", "output").T
    if not ((low < 0) & (high > 0)).all():
        raise InputError(
            f"{key}: expected lo < 0 < hi (-inf or inf where there is no limit), found "
            f"{np.asarray(value, float).tolist()}"
        )
    return low, high


def pairs(key: str, value: Any, count: int, default: list[float], what: str, each: str) -> Floats:
    """Return one pair of numbers per output or input (count x 2), infinite or NaN perhaps.

    Args:
        key: named in errors.
        value: a pair, or one for each; None: the default.
        count: number of outputs or inputs.
        default: a pair.
        what: a pair in words.
        each: output or input.

    Raises:
        InputError: not numbers.
        ShapeError: another shape.
    """
    try:
        given = np.asarray(default if value is None else value, float)
    except (TypeError, ValueError):
        raise InputError(f"{key}: expected {what}, found {value!r:.60}") from None
    given = require_pairs(key, given, count, what, f"such pair per {each}")
    return np.broadcast_to(given, (count, 2)).copy()


def require_pairs(key: str, given: Floats, count: int, what: str, each: str) -> Floats:
    """Return the numbers, if they are one pair (2) or one for each of several things (count x 2).

    Args:
        key: named in errors.
        given: the numbers.
        count: how many things there are.
        what: a pair in words.
        each: for each of which, in words.

    Raises:
        ShapeError: another shape.
    """
    if given.shape not in ((2,), (count, 2)):
        raise ShapeError(
            f"{key}: expected {what}, or one {each} ({count} x 2), "
            f"found {describe_shape(given.shape)}"
        )
    return given


def limits_of(low: Floats, high: Floats) -> Limits | None:
    """Return the limits with finite numbers (p each), or None if no output has any."""
    if not np.isfinite([low, high]).any():
        return None
    return Limits(np.maximum(low, -LARGEST), np.minimum(high, LARGEST))


def require_readings(low: Floats, high: Floats, threshold: Floats) -> None:
    """Raise InputError where every reading of an output is silent or at a limit.

    Args:
        low, high: least and largest readings (p) [y].
        threshold: |y| that counts as silent (p) [y].
    """
    nearest = np.minimum(-low, high)
    within = nearest <= threshold
    if within.any():
        i = int(within.argmax())
        raise InputError(
            f"sensor.range: a limit of {nearest[i]:g} lies within the silence, |y| <= "
            f"{threshold[i]:g} (sensor.threshold): no reading lies between. Check both"
        )
