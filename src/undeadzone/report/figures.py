"""The figure of a run: what the sensor read, what the observer made of it, how far off it was."""

from __future__ import annotations

from typing import TYPE_CHECKING

from undeadzone.report.style import (
    ESTIMATE,
    OTHER,
    PRINTED,
    READING,
    REFERENCE,
    TRUTH,
    axis_label,
    finish,
    plain,
    plot_magnitude,
    shade_gap,
    shade_zone,
    sheet,
)
from undeadzone.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STACKED = 2  # outputs, whose errors and widths stand below them; those of more stand beside them


def overview(run: Run) -> Figure:
    """Per output: z, reading, reference and estimate over the dead zone; errors; widths; then V.

    Many outputs have a row each. A run that diverged is drawn up to where it did.
    """
    outputs = run.z.shape[1]
    if outputs > STACKED:
        rows = rows_beside(outputs, run.V is not None)
        figure, panels = sheet(rows, run.info.title, width=15.0, height=2.2)
    else:
        figure, panels = sheet(rows_below(outputs, run.V is not None), run.info.title)
    for i in range(outputs):
        of = f" {plain(str(run.outputs[i]))}" if outputs > 1 else ""
        output(panels[f"output {i}"], run, i, of)
        _errors(panels[f"error {i}"], run, i, of)
        _widths(panels[f"widths {i}"], run, i, of)
    if run.V is not None:
        plot_magnitude(panels["V"], run.t[run.shown], run.V[run.shown], TRUTH, "V")
        finish(panels["V"], "Lyapunov function", axis_label("V", run.unit("V")), legend=0)
    return figure


def rows_below(outputs: int, with_V: bool) -> list[list[str]]:
    """The panels of few outputs: each output as wide as the figure, what belongs to it below.

    V stands beside the errors of the first output.
    """
    rows = []
    for i in range(outputs):
        rows.append([f"output {i}"] * 6)
        if with_V and i == 0:
            rows.append([f"error {i}"] * 2 + [f"widths {i}"] * 2 + ["V"] * 2)
        else:
            rows.append([f"error {i}"] * 3 + [f"widths {i}"] * 3)
    return rows


def rows_beside(outputs: int, with_V: bool) -> list[list[str]]:
    """The panels of many outputs: a row each, what belongs to it beside; V below all."""
    rows = [[f"output {i}"] * 6 + [f"error {i}"] * 3 + [f"widths {i}"] * 3 for i in range(outputs)]
    return [*rows, ["V"] * 12] if with_V else rows


def output(axes: Axes, run: Run, i: int = 0, of: str = "") -> None:
    """Output i over its dead zone: reference, reading, truth and estimate; of: its name."""
    shown = run.shown
    t = run.t[shown]
    right, left = run.info.widths[2 * i : 2 * i + 2]
    if run.info.sensor == "play":
        shade_gap(axes, t, run.y[shown, i], right, left)
    else:
        shade_zone(axes, right, left)
    if i in run.info.tracked:
        r = run.r[shown, run.info.tracked.index(i)]
        axes.plot(t, r, color=REFERENCE, linewidth=2.6, alpha=0.45, label="reference r")
    axes.plot(t, run.y[shown, i], color=READING, label="reading y")
    axes.plot(t, run.z[shown, i], color=TRUTH, label="output z")
    estimate = run.z_hat[shown, i]
    axes.plot(t, estimate, color=ESTIMATE, linestyle=(0, (4, 2)), label=r"estimate $\hat z$")
    title = f"Output{of} and what is known of it"
    if run.diverged_at is not None:
        title += f", diverged at {run.diverged_at:.4g} s"
    finish(axes, title, axis_label("z, y", run.unit("z")), legend=5)


def _errors(axes: Axes, run: Run, i: int, of: str) -> None:
    """The sizes of the errors of tracking, where output i is tracked, and of estimation."""
    shown = run.shown
    t = run.t[shown]
    if i in run.info.tracked:
        tracking = (run.z[:, i] - run.r[:, run.info.tracked.index(i)])[shown]
        plot_magnitude(axes, t, tracking, REFERENCE, "$|z - r|$")
    plot_magnitude(axes, t, (run.z - run.z_hat)[shown, i], ESTIMATE, r"$|z - \hat z|$")
    finish(axes, f"Errors{of}", axis_label("error", run.unit("z")))


def _widths(axes: Axes, run: Run, i: int, of: str) -> None:
    """The estimated widths of output i over the true ones."""
    shown = run.shown
    for column, name, colour in ((2 * i, "r", PRINTED), (2 * i + 1, "l", OTHER)):
        axes.axhline(run.info.widths[column], color=colour, linewidth=3.0, alpha=0.3)
        axes.plot(run.t[shown], run.d_hat[shown, column], color=colour, label=rf"$\hat d_{name}$")
    finish(axes, f"Widths{of}, truth pale", axis_label("d", run.unit("d_hat")))
