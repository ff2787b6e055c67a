"""Estimated widths over time, of a sensor or an actuator."""

from __future__ import annotations

from typing import TYPE_CHECKING

from undeadzone.report.style import OTHER, PRINTED
from undeadzone.support.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BAND = 2  # standard deviations on either side


def width_lines(axes: Axes, t: Floats, widths: Floats, std: Floats | None, letter: str) -> None:
    """A right and a left width, each in a band of two standard deviations.

    The band does not stretch the axis: at first it is wide.

    Args:
        axes: to draw on.
        t: times (N) [s].
        widths: right and left estimates (N x 2).
        std: their standard deviations (N x 2); None: there are none.
        letter: of the widths, d or b.
    """
    sides = (("r", PRINTED), ("l", OTHER))
    for k, (side, colour) in enumerate(sides):
        axes.plot(t, widths[:, k], color=colour, label=rf"$\hat {letter}_{side}$")
    if std is None:
        return
    limits = axes.get_ylim()
    for k, (_, colour) in enumerate(sides):
        low, high = widths[:, k] - BAND * std[:, k], widths[:, k] + BAND * std[:, k]
        axes.fill_between(t, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.set_ylim(*limits)
