"""How strongly readings move z^, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

LARGER: Final = 0.05  # by which the true z is larger than the model says
NOTHING: Final = 0.005  # share that rounds to 0
LOUD: Final = 0.5  # share of it that z^ must follow, not to be taken on trust


def is_open_loop(shares: Sequence[float | None]) -> bool:
    """Return whether some z^ hardly follows its readings, so that the model is taken on trust."""
    return any(share is not None and share < LOUD for share in shares)


def describe_feedback(shares: Sequence[float | None]) -> str:
    """Return shares, in words.

    Args:
        shares: of each output; None where it cannot be told.
    """
    each = ", ".join(map(_percent, shares))
    if_larger = f"were z {100 * LARGER:.0f} % larger than the model's, z^ would pick up"
    if is_open_loop(shares):
        return f"OPEN LOOP: {if_larger} only {each} of that"
    return f"yes: {if_larger} {each} of that"


def _percent(share: float | None) -> str:
    """Return a share in words."""
    if share is None or math.isnan(share):
        return "unknown"
    return f"{100 * share:.0f} %" if share > -NOTHING else "0 % or less"
