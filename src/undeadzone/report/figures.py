"""Figures of a run: what the sensor read, what the observer made of it, and how far off it was."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from undeadzone.report.style import (
    ESTIMATE,
    OTHER,
    PRINTED,
    READING,
    REFERENCE,
    TRUTH,
    finish,
    label,
    plot_magnitude,
    shade_zone,
    sheet,
    write,
)
from undeadzone.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STACKED = 2  # outputs, whose errors and widths stand below them; those of more stand beside them


def plot(run: Run, path: str | os.PathLike[str]) -> Path:
    """Write a figure of a run (PNG, PDF or SVG by suffix): output, error, widths, V. Raises FileError."""
    return write(overview(run), Path(path))


def overview(run: Run) -> Figure:
    """Per output: z, reading, reference and estimate over the dead zone; errors; widths against truth; then V.

    Many outputs have a row each. A run that diverged is drawn up to where it did.
    """
    shown, outputs = run.shown, run.z.shape[1]
    rows: list[list[str]] = []
    for i in range(outputs):
        below = [f"error {i}", f"widths {i}"]
        if outputs > STACKED:
            rows += [[f"output {i}"] * 6 + [name for name in below for _ in range(3)]]
            continue
        below += ["V"] * (run.V is not None and i == 0)
        rows += [[f"output {i}"] * 6, [name for name in below for _ in range(6 // len(below))]]
    if outputs > STACKED and run.V is not None:
        rows += [["V"] * 12]
    figure, panels = sheet(rows, run.info.title, *((15.0, 2.2) if outputs > STACKED else ()))
    for i in range(outputs):
        of = f" {run.outputs[i]}" if outputs > 1 else ""
        _output(panels[f"output {i}"], run, i, of, shown)
        _errors(panels[f"error {i}"], run, i, of, shown)
        _widths(panels[f"widths {i}"], run, i, of, shown)
    if run.V is not None:
        plot_magnitude(panels["V"], run.t[shown], run.V[shown], TRUTH, "V")
        finish(panels["V"], "Lyapunov function", label("V", run.unit("V")), legend=0)
    return figure


def _output(axes: Axes, run: Run, i: int, of: str, shown: slice) -> None:
    t = run.t[shown]
    shade_zone(axes, run.info.widths[2 * i], run.info.widths[2 * i + 1])
    if i in run.info.tracked:
        axes.plot(
            t,
            run.r[shown, run.info.tracked.index(i)],
            color=REFERENCE,
            linewidth=2.6,
            alpha=0.45,
            label="reference r",
        )
    axes.plot(t, run.y[shown, i], color=READING, label="reading y")
    axes.plot(t, run.z[shown, i], color=TRUTH, label="output z")
    axes.plot(
        t, run.z_hat[shown, i], color=ESTIMATE, linestyle=(0, (4, 2)), label=r"estimate $\hat z$"
    )
    stop = "" if run.diverged_at is None else f", diverged at {run.diverged_at:.4g} s"
    finish(
        axes, f"Output{of} and what is known of it{stop}", label("z, y", run.unit("z")), legend=5
    )


def _errors(axes: Axes, run: Run, i: int, of: str, shown: slice) -> None:
    t = run.t[shown]
    if i in run.info.tracked:
        plot_magnitude(
            axes,
            t,
            (run.z[:, i] - run.r[:, run.info.tracked.index(i)])[shown],
            REFERENCE,
            "$|z - r|$",
        )
    plot_magnitude(axes, t, (run.z - run.z_hat)[shown, i], ESTIMATE, r"$|z - \hat z|$")
    finish(axes, f"Errors{of}", label("error", run.unit("z")))


def _widths(axes: Axes, run: Run, i: int, of: str, shown: slice) -> None:
    for column, name, colour in ((2 * i, "r", PRINTED), (2 * i + 1, "l", OTHER)):
        axes.axhline(run.info.widths[column], color=colour, linewidth=3.0, alpha=0.3)
        axes.plot(run.t[shown], run.d_hat[shown, column], color=colour, label=rf"$\hat d_{name}$")
    finish(axes, f"Widths{of}, truth pale", label("d", run.unit("d_hat")))
