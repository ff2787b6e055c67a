"""Figures of the arena: places with their intervals, regret by scenario, runs in the hidden output, cost against error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from undeadzone.arena.leaderboard import CAP, Row
from undeadzone.arena.traces import Trace
from undeadzone.report.style import (
    ESTIMATE,
    OTHER,
    PRINTED,
    READING,
    REFERENCE,
    TRUTH,
    ZONE,
    finish,
    shade_zone,
    sheet,
)
from undeadzone.support.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST: Final = 3e-3  # regret, of logarithmic axes: below it methods are all but perfect
SHOWN: Final = 4.0  # [s] at the end of a run
COLOURS: Final = (ESTIMATE, READING, PRINTED, OTHER)


def places(rows: Sequence[Row], title: str) -> Figure:
    """Median and worst regret of every method with their intervals, the best on top."""
    figure, panels = sheet([["all"]], title, height=0.24 * len(rows) + 1.2)
    axes = panels["all"]
    at = np.arange(len(rows))[::-1]
    for name, colour, marker in (("median", ESTIMATE, "o"), ("worst", PRINTED, "s")):
        value = np.array([getattr(row, f"{name}_regret") for row in rows])
        ends = np.array([getattr(row, f"{name}_interval") for row in rows])
        axes.hlines(at, *np.clip(ends.T, LEAST, CAP), color=colour, alpha=0.45, linewidth=4)
        axes.plot(
            np.clip(value, LEAST, CAP),
            at,
            marker,
            color=colour,
            markersize=4.5,
            label=f"{name} over the scenarios",
        )
    for x, words in ((1.0, "naive"), (CAP, "diverged")):
        axes.axvline(x, color=ZONE, linewidth=0.9, linestyle=(0, (4, 2)))
        axes.text(x, len(rows) - 0.4, words, color=ZONE, fontsize=8, ha="center", va="bottom")
    axes.set_xscale("log")
    axes.set_xlim(0.85 * LEAST, 1.3 * CAP)
    axes.set_ylim(-0.7, len(rows) + 0.4)
    axes.set_yticks(at, [row.method for row in rows])
    for tick, row in zip(axes.get_yticklabels(), rows, strict=True):
        tick.set_color(ZONE if row.reference else TRUTH)
    finish(
        axes,
        "",
        "",
        f"regret of the rms of z − r, with 95 % intervals; {LEAST:g} and below at the left edge",
        legend=0,
    )
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return figure


def heat(rows: Sequence[Row], regrets: Mapping[str, Floats], scenarios: Sequence[str]) -> Figure:
    """Regret (mean over seeds) of every method on every scenario; a dash where it is not applicable."""
    from matplotlib.colors import LogNorm

    figure, panels = sheet(
        [["all"]],
        "Regret by scenario",
        width=2.6 + 0.52 * len(scenarios),
        height=0.25 * len(rows) + 1.6,
    )
    axes = panels["all"]
    table = np.array([regrets[row.method].mean(axis=1) for row in rows])
    shown = np.clip(table, 0.01, CAP)
    axes.imshow(shown, norm=LogNorm(0.01, CAP), cmap="RdYlBu_r", aspect="auto")
    for (i, j), value in np.ndenumerate(table):
        dark = shown[i, j] < 0.03 or shown[i, j] > 3
        axes.text(
            j,
            i,
            _cell(value),
            ha="center",
            va="center",
            fontsize=6.5,
            color="white" if dark else TRUTH,
        )
    axes.set_xticks(
        range(len(scenarios)), scenarios, rotation=60, ha="right", rotation_mode="anchor"
    )
    axes.set_yticks(range(len(rows)), [row.method for row in rows])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    finish(
        axes,
        "0: full state, 1: naive; blue is good, red is bad, a dash: not applicable",
        "",
        "",
        legend=0,
    )
    return figure


def _cell(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return (
        f"{value:.0f}"
        if value >= 9.95
        else f"{value:.1f}"
        if value >= 0.995
        else f"{value:.2f}".replace("0.", ".", 1).replace("-", "−")
    )


def traces(found: Sequence[Trace]) -> Figure:
    """The hidden output under each method in the last seconds, and |z - r| over the whole run."""
    rows = [[trace.method] * 2 for trace in found] + [["errors"] * 2]
    figure, panels = sheet(rows, f"{found[0].scenario}: the hidden output", height=2.1)
    for trace in found:
        axes, tail = panels[trace.method], trace.t > trace.t[-1] - SHOWN
        shade_zone(axes, *trace.widths)
        axes.plot(
            trace.t[tail],
            trace.r[tail],
            color=REFERENCE,
            linewidth=2.6,
            alpha=0.45,
            label="reference r",
        )
        axes.plot(trace.t[tail], trace.z[tail], color=TRUTH, label="output z")
        axes.plot(
            trace.t[tail],
            trace.z_hat[tail],
            color=ESTIMATE,
            linestyle=(0, (4, 2)),
            label=r"estimate $\hat z$",
        )
        largest = 2.5 * np.abs(trace.r).max()
        low, high = axes.get_ylim()
        axes.set_ylim(max(low, -largest), min(high, largest))
        finish(axes, trace.method, "z", "", legend=4)
    axes = panels["errors"]
    axes.set_yscale("log")
    for trace, colour in zip(found, COLOURS, strict=False):
        axes.plot(trace.t, _envelope(np.abs(trace.z - trace.r)), color=colour, label=trace.method)
    axes.set_ylim(top=min(axes.get_ylim()[1], 20 * np.abs(found[0].r).max()))
    finish(axes, "|z − r|, the largest within half a second", "|z − r|", legend=4)
    return figure


def _envelope(size: Floats, parts: int = 40) -> Floats:
    """The largest value within each of `parts` spans, at every sample."""
    spans = np.array_split(np.nan_to_num(size, nan=np.inf), parts)
    return np.concatenate([np.full(span.size, max(span.max(), 1e-6)) for span in spans])


def costs(rows: Sequence[Row]) -> Figure:
    """Median regret against the cost of a step; the methods are numbered by their places."""
    figure, panels = sheet(
        [["all"] * 3 + ["names"]], "Cost against error", height=max(4.6, 0.155 * len(rows) + 0.6)
    )
    axes, names = panels["all"], panels["names"]
    for place, row in enumerate(rows, 1):
        if row.cost is None:
            continue
        x, y = row.cost, float(np.clip(row.median_regret, LEAST, CAP))
        colour = ZONE if row.reference else ESTIMATE
        axes.plot(x, y, "o", color=colour, markersize=11, alpha=0.25, markeredgewidth=0)
        axes.text(x, y, str(place), color=TRUTH, fontsize=6.5, ha="center", va="center")
        names.text(
            0.0,
            1 - place / (len(rows) + 1),
            f"{place:>2}  {row.method}",
            color=colour if row.reference else TRUTH,
            fontsize=8,
            va="center",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.06)
    names.set_axis_off()
    finish(axes, "", "median regret", "cost of a step, in those of the naive observer", legend=0)
    return figure
