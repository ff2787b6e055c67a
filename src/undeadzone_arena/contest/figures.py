"""Figures of the arena: ranks, regret by scenario, example runs, cost against error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from undeadzone.report import ink
from undeadzone.report.style import create_panels, escape_formulas, finish_panel, shade_zone
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.leaderboard import CAP, Row
from undeadzone_arena.contest.traces import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST: Final = 3e-3  # regret, of logarithmic axes: below it methods are all but perfect
TRACE_SECONDS: Final = 4.0  # [s] at the end of a run
COLOURS: Final = (ink.ESTIMATE, ink.READING, ink.PRINTED, ink.OTHER)


def plot_ranking(rows: Sequence[Row], title: str) -> Figure:
    """Plot median and worst regret of every method with their intervals, the best on top."""
    figure, panels = create_panels([["all"]], title, height=0.24 * len(rows) + 1.2)
    plot_leaderboard(panels["all"], rows)
    return figure


def plot_leaderboard(axes: Axes, rows: Sequence[Row]) -> None:
    """Plot median and worst regret of every method with their intervals, the best on top."""
    at = np.arange(len(rows))[::-1]  # heights of the methods
    medians = [row.median_regret for row in rows]
    worst = [row.worst_regret for row in rows]
    _plot_regrets(
        axes, at, medians, [row.median_interval for row in rows], "median", ink.ESTIMATE, "o"
    )
    _plot_regrets(axes, at, worst, [row.worst_interval for row in rows], "worst", ink.PRINTED, "s")
    for x, words in ((1.0, "half a zone"), (CAP, "diverged")):
        axes.axvline(x, color=ink.ZONE, linewidth=0.9, linestyle=(0, (4, 2)))
        axes.text(x, len(rows) - 0.4, words, color=ink.ZONE, fontsize=8, ha="center", va="bottom")
    axes.set_xscale("log")
    axes.set_xlim(0.85 * LEAST, 1.3 * CAP)
    axes.set_ylim(-0.7, len(rows) + 0.4)
    axes.set_yticks(at, [row.method for row in rows])
    for tick, row in zip(axes.get_yticklabels(), rows, strict=True):
        tick.set_color(ink.ZONE if row.reference else ink.TRUTH)
    left_edge = f"{LEAST:g} and below at the left edge"
    regret = f"regret of the rms of z − r, with 95 % intervals; {left_edge}"
    finish_panel(axes, "", "", regret, legend=0)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)


def _plot_regrets(
    axes: Axes,
    at: np.ndarray,
    regret: list[float],
    intervals: list[tuple[float, float]],
    name: str,
    colour: str,
    marker: str,
) -> None:
    """Plot a marker for the regret of each method, on a bar for its interval."""
    low, high = np.clip(np.array(intervals).T, LEAST, CAP)
    axes.hlines(at, low, high, color=colour, alpha=0.45, linewidth=4)
    clipped = np.clip(np.array(regret), LEAST, CAP)
    words = f"{name} over the scenarios"
    axes.plot(clipped, at, marker, color=colour, markersize=4.5, label=words)


def plot_regret_map(
    rows: Sequence[Row], regrets: Mapping[str, Floats], scenarios: Sequence[str]
) -> Figure:
    """Plot the regret of every method on every scenario, with a dash if not applicable.

    Args:
        rows: the methods in order
        regrets: of each method (scenarios x seeds). The mean over seeds is shown
        scenarios: their titles
    """
    from matplotlib.colors import LogNorm

    width = max(6.4, 2.6 + 0.52 * len(scenarios))
    height = 0.25 * len(rows) + 1.6
    figure, panels = create_panels([["all"]], "Regret by scenario", width=width, height=height)
    axes = panels["all"]
    table = np.array([regrets[row.method].mean(axis=1) for row in rows])
    clipped = np.clip(table, 0.01, CAP)
    axes.imshow(clipped, norm=LogNorm(0.01, CAP), cmap="RdYlBu_r", aspect="auto")
    for (i, j), value in np.ndenumerate(table):
        dark = clipped[i, j] < 0.03 or clipped[i, j] > 3
        colour = "white" if dark else ink.TRUTH
        axes.text(
            j, i, regret_cell_text(value), ha="center", va="center", fontsize=6.5, color=colour
        )
    axes.set_xticks(
        range(len(scenarios)),
        list(map(escape_formulas, scenarios)),
        rotation=60,
        ha="right",
        rotation_mode="anchor",
    )
    axes.set_yticks(range(len(rows)), [row.method for row in rows])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    scale = "0: all is known, 1: half a zone"
    finish_panel(axes, scale, "", "", legend=0)
    return figure


def regret_cell_text(value: float) -> str:
    """Return a regret in short form: `12`, `1.2`, `.12` or `−.12`, or a dash if not finite."""
    if not np.isfinite(value):
        return "–"
    if value >= 9.95:
        return f"{value:.0f}"
    if value >= 0.995:
        return f"{value:.1f}"
    return f"{value:.2f}".replace("0.", ".", 1).replace("-", "−")


def plot_traces(runs: Sequence[Trace]) -> Figure:
    """Plot the hidden output in the last seconds for each method, and |z - r| over the run."""
    rows = [[trace.method] * 2 for trace in runs] + [["errors"] * 2]
    figure, panels = create_panels(rows, f"{runs[0].scenario}: the hidden output", height=2.1)
    for trace in runs:
        _plot_trace(panels[trace.method], trace)
    axes = panels["errors"]
    axes.set_yscale("log")
    for trace, colour in zip(runs, COLOURS, strict=False):
        size = span_envelope(np.abs(trace.z - trace.r))
        axes.plot(trace.t, size, color=colour, label=trace.method)
    axes.set_ylim(top=min(axes.get_ylim()[1], 20 * np.abs(runs[0].r).max()))
    finish_panel(axes, "|z − r|, the largest within half a second", "|z − r|", legend=4)
    return figure


def _plot_trace(axes: Axes, trace: Trace) -> None:
    """Plot reference, output and estimate of one method in the last seconds."""
    tail = trace.t > trace.t[-1] - TRACE_SECONDS
    t = trace.t[tail]
    r = trace.r[tail]
    z = trace.z[tail]
    z_hat = trace.z_hat[tail]
    shade_zone(axes, *trace.widths)
    axes.plot(t, r, color=ink.REFERENCE, linewidth=2.6, alpha=0.45, label="reference r")
    axes.plot(t, z, color=ink.TRUTH, label="output z")
    axes.plot(t, z_hat, color=ink.ESTIMATE, linestyle=(0, (4, 2)), label="estimate ẑ")
    largest = 2.5 * np.abs(trace.r).max()
    low, high = axes.get_ylim()
    axes.set_ylim(max(low, -largest), min(high, largest))
    finish_panel(axes, trace.method, "z", "", legend=4)


def span_envelope(size: Floats, parts: int = 40) -> Floats:
    """Return the largest value within each of `parts` spans, at every sample."""
    spans = np.array_split(np.nan_to_num(size, nan=np.inf), min(parts, size.size))
    return np.concatenate([np.full(span.size, max(span.max(), 1e-6)) for span in spans])


def plot_costs(rows: Sequence[Row]) -> Figure:
    """Plot median regret against the cost of a step. The methods are numbered by their ranks."""
    height = max(4.6, 0.155 * len(rows) + 0.6)
    figure, panels = create_panels([["all"] * 3 + ["names"]], "Cost against error", height=height)
    axes = panels["all"]
    names = panels["names"]
    for place, row in enumerate(rows, 1):
        if row.cost is None:
            continue
        x = row.cost
        y = float(np.clip(row.median_regret, LEAST, CAP))
        colour, number = (ink.ZONE, ink.ZONE) if row.reference else (ink.ESTIMATE, ink.TRUTH)
        axes.plot(x, y, "o", color=colour, markersize=11, alpha=0.25, markeredgewidth=0)
        axes.text(x, y, str(place), color=ink.TRUTH, fontsize=6.5, ha="center", va="center")
        words = f"{place:>2}  {row.method}"
        down = 1 - place / (len(rows) + 1)
        names.text(0.0, down, words, color=number, fontsize=8, va="center")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.06)
    names.set_axis_off()
    finish_panel(
        axes, "", "median regret", "cost of a step, in those of the naive observer", legend=0
    )
    return figure
