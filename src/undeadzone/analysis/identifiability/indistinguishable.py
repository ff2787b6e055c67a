"""Indistinguishable parameters: an example of widths that give the same readings.

Among all changes of the unknowns that the readings do not determine, or not better than noise and
prior allow, it is the likeliest one that moves a width, or d_r - d_l, to the end of its 95 %
interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from undeadzone.analysis.identifiability.linear import Unobservable
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats
from undeadzone.util.text import HALF_95

NEAR: Final = 0.05  # of the larger width: closer truths are not reported
PART: Final = 0.25  # of the larger width: shift of a width that is not identifiable


def least_known_change(hidden: Unobservable, covariance: Floats, i: int, widths: Floats) -> Floats:
    """Return the change of the unknowns that readings determine least in output i's widths
    (N).

    Args:
        hidden: changes that no reading shows.
        covariance: of the unknowns as far as readings determine them (N x N).
        i: the output.
        widths: d_r, d_l (2) [z], 0 or above after the change.
    """
    first = hidden.n + 2 * i
    pair = slice(first, first + 2)
    size = float(widths.max()) or 1.0
    lost = [name for name in DIRECTIONS if not hidden.is_width_known(i, name)]
    std = hidden.std_of_widths(i, covariance)
    name = (
        lost[0] if lost else max(DIRECTIONS, key=lambda name: std[name] * _direction_weight(name))
    )
    along = np.zeros(hidden.scale.size)
    along[pair] = DIRECTIONS[name]
    if lost:
        change = hidden.scale * (hidden.basis @ (hidden.basis.T @ (hidden.scale * along)))
        change *= PART * size / np.abs(change[pair]).max()
    else:
        change = HALF_95 * covariance @ along / max(std[name], np.finfo(float).tiny)
    shrinks = change[pair] < 0
    room = (widths[shrinks] / -change[pair][shrinks]).min(initial=1.0)
    return np.asarray(min(room, 1.0) * change)


def indistinguishable_widths(
    hidden: Unobservable,
    covariance: Floats,
    i: int,
    widths: Floats,
    start: Floats,
    constants: Floats,
) -> dict[str, Any] | None:
    """Return parameters that give the same readings as the declared truth, or None.

    None means that their widths are nearly the same.

    Args:
        hidden, covariance, i, widths: as of `least_known_change`.
        start: how x(0) follows the change (n x N).
        constants: how constants at the inputs do (m x N).

    Returns:
        Its `right` and `left` [z], and how much `start` (n) and `input` (m) are larger there.
    """
    change = least_known_change(hidden, covariance, i, widths)
    first = hidden.n + 2 * i
    moved = change[first : first + 2]
    if np.abs(moved).max() < NEAR * widths.max():
        return None
    right, left = (widths + moved).tolist()
    rest = {"start": (start @ change).tolist(), "input": (constants @ change).tolist()}
    return {"right": right, "left": left, **rest}


def describe_indistinguishable(truths: Sequence[Mapping[str, Any] | None]) -> list[str]:
    """Describe the indistinguishable parameters of each output."""
    lines = []
    for i, one in enumerate(truths):
        if one is None:
            continue
        moved = [f"a constant {_format_values(one['input'])} more at the input"] * any(one["input"])
        moved += [f"x(0) larger by {_format_values(one['start'])}"] * any(one["start"])
        where = f"output {i}: " if len(truths) > 1 else ""
        lines.append(f"{where}d_r {one['right']:.4g}, d_l {one['left']:.4g}, {' and '.join(moved)}")
    return lines


def _format_values(values: Sequence[float]) -> str:
    """Format a number, or several in brackets. Numbers near 0 beside the largest become 0."""
    given = np.array(values)
    given[np.abs(given) < NEAR * np.abs(given).max()] = 0.0
    texts = [f"{value:.3g}" for value in given]
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


def _direction_weight(name: str) -> float:
    """Return the weight of a direction whose deviation is compared: 1 over its length."""
    return float(1 / np.linalg.norm(DIRECTIONS[name]))
