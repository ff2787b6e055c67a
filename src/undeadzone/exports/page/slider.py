"""A slider of the page: its range, its steps, and the numbers of the loop that it moves."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

ROUND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
TICKS = 60  # steps of a slider, about


class Slider(NamedTuple):
    """A slider of the page.

    Attributes:
        key: its name in the link.
        label: its name on the page.
        unit: of its value.
        value: the scenario's own value.
        least, most, grid: the range, and the step in it.
        moves: (entry of the loop's params, factors of the changes of the value and its square).
    """

    key: str
    label: str
    unit: str
    value: float
    least: float
    most: float
    grid: float
    moves: list[tuple[int, float, float]]


class Range(NamedTuple):
    """What a slider may take.

    Attributes:
        key, label, unit, value, least, most: as of `Slider`.
    """

    key: str
    label: str
    unit: str
    value: float
    least: float
    most: float


def slider_of(wanted: Range, moves: list[tuple[int, float, float]]) -> Slider:
    """A slider of a range, with steps of a round size."""
    grid = nice((wanted.most - wanted.least) / TICKS, (1.0, 2.0, 5.0))
    most = max(wanted.most, wanted.value)
    least = min(wanted.least, wanted.value)
    return Slider(wanted.key, wanted.label, wanted.unit, wanted.value, least, most, grid, moves)


def nice(value: float, factors: tuple[float, ...] = ROUND) -> float:
    """The nearest round number that is not smaller: a factor times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    for factor in factors:
        if factor * power >= value * (1 - 1e-9):
            return float(f"{factor * power:.12g}")
    return float(f"{10 * power:.12g}")


def as_data(slider: Slider) -> dict[str, Any]:
    """A slider as the page reads it."""
    return slider._asdict()
