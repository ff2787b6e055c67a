"""Another truth with the same readings: what stays unknown, shown by an example.

Of all changes of the unknowns that the readings cannot tell, or not better than noise and prior
allow, it is the likeliest one that moves a width, or d_r - d_l, to the end of its 95 % interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from undeadzone.analysis.identifiability.linear import Unobservable
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats
from undeadzone.util.text import HALF_95

NEAR: Final = 0.05  # of the larger width: truths less far apart are not told
PART: Final = 0.25  # of the larger width, by which one moves that nothing tells


def farthest(hidden: Unobservable, covariance: Floats, i: int, widths: Floats) -> Floats:
    """Return the change of the unknowns that readings tell least of output i's widths.

    Args:
        hidden: what no reading shows.
        covariance: of the unknowns as far as readings tell them (N x N).
        i: the output.
        widths: d_r, d_l (2) [z]; they stay at 0 or above.
    """
    first = hidden.n + 2 * i
    pair = slice(first, first + 2)
    size = float(widths.max()) or 1.0
    lost = [name for name in DIRECTIONS if not hidden.width(i, name)]
    std = hidden.deviations(i, covariance)
    name = lost[0] if lost else max(DIRECTIONS, key=lambda name: std[name] * _weight(name))
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


def second_truth(
    hidden: Unobservable,
    covariance: Floats,
    i: int,
    widths: Floats,
    start: Floats,
    constants: Floats,
) -> dict[str, Any] | None:
    """Return a truth beside the one that is declared; None where its widths are nearly the same.

    Args:
        hidden, covariance, i, widths: as of `farthest`.
        start: how x(0) follows the change (n x N).
        constants: how constants at the inputs do (m x N).

    Returns:
        Its `right` and `left` [z], and how much `start` (n) and `input` (m) are larger there.
    """
    change, first = farthest(hidden, covariance, i, widths), hidden.n + 2 * i
    moved = change[first : first + 2]
    if np.abs(moved).max() < NEAR * widths.max():
        return None
    right, left = (widths + moved).tolist()
    rest = {"start": (start @ change).tolist(), "input": (constants @ change).tolist()}
    return {"right": right, "left": left, **rest}


def in_words(truths: Sequence[Mapping[str, Any] | None]) -> list[str]:
    """Return second truths of outputs in words."""
    told = []
    for i, one in enumerate(truths):
        if one is None:
            continue
        moved = [f"a constant {_numbers(one['input'])} more at the input"] * any(one["input"])
        moved += [f"x(0) larger by {_numbers(one['start'])}"] * any(one["start"])
        where = f"output {i}: " if len(truths) > 1 else ""
        told.append(f"{where}d_r {one['right']:.4g}, d_l {one['left']:.4g}, {' and '.join(moved)}")
    return told


def _numbers(values: Sequence[float]) -> str:
    """Return one number, or several in brackets; what is nearly 0 beside the largest is 0."""
    given = np.array(values)
    given[np.abs(given) < NEAR * np.abs(given).max()] = 0.0
    texts = [f"{value:.3g}" for value in given]
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


def _weight(name: str) -> float:
    """Of a direction among those whose deviations are compared: one over its length."""
    return float(1 / np.linalg.norm(DIRECTIONS[name]))
