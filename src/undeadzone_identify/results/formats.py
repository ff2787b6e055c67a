"""Numbers of an answer with their intervals and units, as text."""

from __future__ import annotations

import numpy as np

from undeadzone.util.text import bracket_interval
from undeadzone_identify.models.estimates import Interval


def unit_suffix(unit: str) -> str:
    """Return a unit behind a number.

    Args:
        unit: "1" for none.
    """
    return "" if unit == "1" else f" {unit}"


def describe_interval(interval: Interval, unit: str) -> str:
    """Describe a value with its interval, with significant digits only.

    Args:
        interval: the value, its low and its high end.
        unit: behind the numbers, with a blank ahead.
    """
    value, low, high = interval
    if not np.isfinite(high):
        if not np.isfinite(low):
            return "unknown: an offset would shift it"
        return f"at least {low:.4g}{unit}: no reading lies beyond this edge"
    if high == low:
        return f"{value:.6g}{unit}"
    digits = max(0, int(np.ceil(-np.log10(max(high - low, 1e-300)))) + 2)
    return f"{bracket_interval(value, low, high, f'.{min(digits, 12)}f')}{unit}"


def describe_ends(middle: float, left: Interval, right: Interval) -> str:
    """Describe the ends of an input's zone in the log.

    Args:
        middle: input from which the widths count.
        left, right: widths.
    """
    return f"nothing happens between {middle - left.value:.6g} and {middle + right.value:.6g}"
