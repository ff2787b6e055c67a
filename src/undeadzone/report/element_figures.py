"""Figures of a log in which a play, or an actuator's dead zone, was found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from undeadzone.report.style import ESTIMATE, OTHER, READING, TRUTH, finish, label, sheet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undeadzone.identification.answer.result import Identified
    from undeadzone.identification.verdict.which import Element
    from undeadzone.support.arrays import Floats

MOST = 600  # samples of a figure over time: the last ones
NAMES = {"play": "the play", "both": "play and dead zone", "input_zone": "the plant"}
SIDES = {"input_zone": "Side of the input"}


def figures(found_log: Identified, element: Element) -> dict[str, Figure]:
    """The figures of an element: over time, and reading by output.

    Args:
        found_log: the answer.
        element: what was found in it.
    """
    return {"overview": _over_time(found_log, element), "element": _by_output(found_log, element)}


def _over_time(found_log: Identified, element: Element) -> Figure:
    """z^, what is read of it, and the readings; contacts or sides below."""
    answer = found_log.answer
    grid, scale = answer.case.grid, answer.scale
    part = slice(max(0, grid.t.size - MOST), grid.t.size)
    unit = grid.output_unit
    time = "t [samples]" if grid.counted else "t [s]"
    figure, panels = sheet([["signals"], ["signals"], ["sides"]], "The log and its fit", height=1.9)
    axes = panels["signals"]
    t = grid.t[part]
    axes.plot(t, (element.z * scale)[part], color=ESTIMATE, label=r"plant's $\hat z$")
    y = np.where(grid.ok, grid.y, np.nan)[part]
    axes.plot(t, y, color=READING, linewidth=1.0, label="reading y")
    if element.kind != "input_zone":
        expected = (element.readings * scale)[part]
        axes.plot(t, expected, color=OTHER, linewidth=1.0, label=f"{NAMES[element.kind]} of it")
    finish(axes, "The end of the log", label("z, y", unit), "")
    axes = panels["sides"]
    axes.plot(t, element.side[part], color=TRUTH, linewidth=0.8, drawstyle="steps-post")
    middle = "silent" if element.kind == "input_zone" else "holds"
    axes.set_yticks([-1, 0, 1], ["left", middle, "right"])
    axes.set_ylim(-1.3, 1.3)
    finish(axes, SIDES.get(element.kind, "Contact"), "", time, legend=0)
    return figure


def _by_output(found_log: Identified, element: Element) -> Figure:
    """Readings by z^ with the path of what is expected; by u where the input has the zone."""
    answer = found_log.answer
    grid, scale = answer.case.grid, answer.scale
    figure, panels = sheet([["map", "left"]], "What was found", height=3.4)
    axes, unit = panels["map"], grid.output_unit
    z = element.z * scale
    _dots(axes, z[grid.ok], grid.y[grid.ok])
    if element.kind == "input_zone":
        finish(axes, "Reading by z^", label("y", unit), label(r"$\hat z$", unit))
    else:
        part = slice(max(0, z.size - MOST), z.size)
        axes.plot(z[part], (element.readings * scale)[part], color=ESTIMATE, linewidth=1.0,
                  label=f"path of {NAMES[element.kind]}")  # fmt: skip
        finish(axes, "Reading by z^, and its path", label("y", unit), label(r"$\hat z$", unit))
    axes = panels["left"]
    residual = (answer.fit.objective.data.y - element.readings) * scale
    if element.kind == "input_zone":
        u = grid.u[:, 0]
        _dots(axes, u[grid.ok], residual[grid.ok])
        finish(axes, "What is left, by the input", label("y - E[y]", unit),
               label("u", grid.input_unit))  # fmt: skip
    else:
        _dots(axes, z[grid.ok], residual[grid.ok])
        finish(axes, "What is left", label("y - E[y]", unit), label(r"$\hat z$", unit))
    return figure


def _dots(axes: Axes, x: Floats, y: Floats) -> None:
    """Single readings."""
    axes.plot(
        x, y, ".", color=READING, markersize=1.5, alpha=0.5, label="readings", rasterized=True
    )
