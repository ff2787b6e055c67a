"""The gaps of a play ahead of a dead zone, as an observer ends up with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from undeadzone.interfaces import Estimate
from undeadzone.support.arrays import Floats, one_or_list
from undeadzone.support.text import with_deviation, with_unit

SYMBOLS: Final = ("c_r^", "c_l^", "c_r^ + c_l^")  # of what `gaps_with_deviations` shows


def gap_signals(estimate: Estimate) -> dict[str, Floats]:
    """The signals of gaps that are estimated, by name; nothing where none are.

    Args:
        estimate: a row for each sample in each field.
    """
    if not estimate.gap_std.shape[1]:
        return {}
    return {
        "c_hat": _interleaved(estimate.gap_right, estimate.gap_left),
        "c_std": _interleaved(estimate.gap_right_std, estimate.gap_left_std),
        "gap_std": estimate.gap_std,
    }


def gap_numbers(
    c_hat: Floats | None, c_std: Floats | None, gap_std: Floats | None
) -> dict[str, Any]:
    """The final gaps with their deviations, for a summary; nothing where none are estimated.

    Args:
        c_hat, c_std: [c_r^, c_l^] of each output in turn, and their deviations (N x 2p) [z].
        gap_std: deviation of c_r^ + c_l^ (N x p) [z].
    """
    if c_hat is None or c_std is None or gap_std is None:
        return {}
    numbers = {
        "gap_right": c_hat[-1, 0::2],
        "gap_left": c_hat[-1, 1::2],
        "gap_right_std": c_std[-1, 0::2],
        "gap_left_std": c_std[-1, 1::2],
        "gap_std": gap_std[-1],
    }
    return {name: one_or_list(value) for name, value in numbers.items()}


def in_words(
    numbers: Mapping[str, Any], unit: str, true: Sequence[float] | None = None
) -> dict[str, str]:
    """The final gaps of a single output and their sum, which readings tell better, in words.

    Args:
        numbers: of `gap_numbers`, of one output.
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


def _interleaved(right: Floats, left: Floats) -> Floats:
    """[right, left] of each output side by side (N x 2p)."""
    return np.stack((right, left), axis=2).reshape(len(right), -1)
