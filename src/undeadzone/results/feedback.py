"""Description of the feedback strength: the share of a model error that readings correct."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

LARGER: Final = 0.05  # by which the true z is larger than the model's
NOTHING: Final = 0.005  # share that rounds to 0
LOUD: Final = 0.5  # share of it that z^ must follow, not to be taken on trust


def has_weak_feedback(shares: Sequence[float | None]) -> bool:
    """Return whether the readings hardly correct some z^, so that the model alone determines
    it.
    """
    return any(share is not None and share < LOUD for share in shares)


def describe_feedback(shares: Sequence[float | None]) -> str:
    """Return the feedback shares of all outputs as text.

    Args:
        shares: of each output (None if unknown).
    """
    each = ", ".join(map(_format_percent, shares))
    if_larger = f"were z {100 * LARGER:.0f} % larger than the model's, z^ would pick up"
    if has_weak_feedback(shares):
        return f"OPEN LOOP: {if_larger} only {each} of that"
    return f"yes: {if_larger} {each} of that"


def _format_percent(share: float | None) -> str:
    """Return a share in percent as text."""
    if share is None or math.isnan(share):
        return "unknown"
    return f"{100 * share:.0f} %" if share > -NOTHING else "0 % or less"
