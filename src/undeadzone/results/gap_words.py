"""The gaps of a play ahead of a dead zone, as an observer ends up with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from undeadzone.support.arrays import Floats
from undeadzone.support.text import with_deviation, with_unit

SYMBOLS: Final = ("c_r^", "c_l^", "c_r^ + c_l^")  # of what `gaps_with_deviations` shows


def in_words(
    numbers: Mapping[str, Any], unit: str, true: Sequence[float] | None = None
) -> dict[str, str]:
    """The final gaps of a single output and their sum, which readings tell better, in words.

    Args:
        numbers: final ones, of one output.
        unit: of z.
        true: [c_r, c_l] [z]; None: nobody knows them.
    """
    right, left = numbers["gap_right"], numbers["gap_left"]
    both = None if right is None or left is None else right + left
    values = {"gap_right": right, "gap_left": left, "gap": both}
    truth = None if true is None else dict(zip(values, (*true, sum(true)), strict=True))
    shown = {}
    for name, value in values.items():
        words = with_unit(with_deviation(value, numbers[f"{name}_std"]), unit)
        label = "gap_right + gap_left" if name == "gap" else name
        shown[label] = words if truth is None else f"{words} (true {truth[name]:.6g})"
    return shown


def gaps_with_deviations(gaps: Floats, stds: Floats, both: float) -> list[str]:
    """The gaps of one output and their sum, for a page: c_r^, c_l^, c_r^ + c_l^.

    Args:
        gaps, stds: [c_r^, c_l^] and their deviations (2) [z].
        both: deviation of c_r^ + c_l^ [z].
    """
    pairs = zip((*gaps, gaps.sum()), (*stds, both), strict=True)
    return [with_deviation(float(value), float(std)) for value, std in pairs]
