"""Figures of what decides in an ensemble: which entries count, and the metric over them."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from undeadzone.ensemble.result import JUDGED, MAIN, Ensemble
from undeadzone.report import ink
from undeadzone.report.ensemble_figures import SPREAD, words
from undeadzone.report.style import axis_label, finish, plain, sheet
from undeadzone.statistics.intervals import LEVEL
from undeadzone.support.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Sensitivities: TypeAlias = Mapping[str, dict[str, Any]]  # by entry, as in `Ensemble.summary`
Index: TypeAlias = Mapping[str, float]  # of one entry: value, low and high of its interval
Scale = Literal["log", "linear"]
ROWS: Final = 12  # entries in the tornado
WORST: Final = 20  # runs that are marked


class Marked(NamedTuple):
    """Numbers of runs: those with a finite metric, those that diverged, the worst, the median one.

    Of runs beyond the first `JUDGED` only the worst are shown.
    """

    shown: npt.NDArray[np.intp]
    diverged: npt.NDArray[np.intp]
    worst: npt.NDArray[np.intp]
    typical: int | None


def tornado(sensitivities: Sensitivities, metric: str = MAIN) -> Figure | None:
    """Partial rank correlation and Sobol indices, the most influential entry on top.

    Args:
        sensitivities: of the entries, as in a summary; None is returned if there are none
        metric: what the entries decide
    """
    if not sensitivities:
        return None
    names = list(sensitivities)[:ROWS]
    title, height = f"What decides the {words(metric)}", 1.6 + 0.34 * len(names)
    figure, panels = sheet([["rank", "share"]], title, height=height)
    rank, share = panels["rank"], panels["share"]
    _ranks(rank, [sensitivities[name]["partial"] for name in names])
    _shares(share, [sensitivities[name] for name in names])
    _name_rows(share, [""] * len(names))
    _name_rows(rank, [fill(plain(name), 30) for name in names])
    ranked = "More of it is worse (right) or better (left)"
    finish(rank, ranked, "", "partial rank correlation", legend=0)
    finish(share, "Share of the variance that comes from it", "", "Sobol index", legend=3)
    rank.set_ylim(share.get_ylim())
    return figure


def _name_rows(axes: Axes, names: list[str]) -> None:
    """A row for each name, the first on top."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def _ranks(axes: Axes, partial: list[dict[str, float]]) -> None:
    """Bars of partial rank correlations."""
    _bars(axes, 0.0, 0.62, partial, color=[_rank_colour(index) for index in partial])
    axes.axvline(0.0, color=ink.TRUTH, linewidth=0.8)
    axes.set_xlim(-1.05, 1.05)


def _rank_colour(index: Index) -> str:
    """Grey where it may be chance, else by sign."""
    if index["p"] > 1 - LEVEL:
        return ink.ZONE
    return ink.PRINTED if index["value"] > 0 else ink.ESTIMATE


def _shares(axes: Axes, sensitivities: list[dict[str, Any]]) -> None:
    """Bars of Sobol indices: alone, and with interactions where those are known."""
    first = [each["first_order"] for each in sensitivities]
    total = [each["total_order"] for each in sensitivities]
    if total[0] is None:
        _bars(axes, 0.0, 0.62, first, color=ink.REFERENCE, label="alone")
        floor = sensitivities[0]["floor"]
        axes.axvline(floor, color=ink.ZONE, linestyle=(0, (3, 2)), label="chance")
    else:
        _bars(axes, -0.16, 0.31, first, color=ink.REFERENCE, label="alone")
        _bars(axes, 0.16, 0.31, total, color=ink.OTHER, label="with interactions")
    largest = max(index["high"] for index in first + total if index is not None)
    axes.set_xlim(0.0, min(1.02, 0.02 + 1.08 * largest))


def _bars(
    axes: Axes, shift: float, thick: float, indices: list[dict[str, float]], **style: Any
) -> None:
    """A bar with its interval for each index."""
    values = [index["value"] for index in indices]
    below = [index["value"] - index["low"] for index in indices]
    above = [index["high"] - index["value"] for index in indices]
    axes.barh(
        np.arange(len(indices)) + shift,
        values,
        thick,
        xerr=[below, above],
        error_kw={"elinewidth": 1.0, "ecolor": ink.TRUTH, "capsize": 2.0},
        alpha=0.75,
        **style,
    )


def influence(result: Ensemble, sensitivities: Sensitivities, metric: str = MAIN) -> Figure | None:
    """The metric over each of the two most influential entries, and over both.

    The worst runs, the median one and those that diverged are marked.

    Args:
        result: of which runs are shown
        sensitivities: of its entries, as in a summary; None is returned if there are none
        metric: what is shown
    """
    if not sensitivities:
        return None
    names = list(sensitivities)[:2]
    two = len(names) == 2
    title = "The most influential entries"
    if two:
        figure, panels = sheet([[*names, "both"]], title, width=13.0, height=4.4)
    else:
        figure, panels = sheet([names], title, width=6.5, height=4.4)
    values = np.where(result.diverged, np.nan, result.column(metric))
    runs = _marked(result, values, metric)
    scale = _scale(values[runs.shown])
    quantity = axis_label(words(metric, result.info.duration), result.unit(metric))
    labels = [axis_label(plain(name), result.unit(name)) for name in names]
    for name, x_label in zip(names, labels, strict=True):
        _over_one(panels[name], result.column(name), values, runs, scale)
        finish(panels[name], f"Over {name}", quantity, x_label, legend=3)
    if two:
        both = panels["both"]
        x, y = map(result.column, names)
        colours = _over_both(both, x, y, values, runs, scale)
        figure.colorbar(colours, ax=both, pad=0.02).set_label(f"median of the {quantity}")
        finish(both, "Over both", labels[1], labels[0], legend=3)
    return figure


def _marked(result: Ensemble, values: Floats, metric: str) -> Marked:
    """The runs that are shown and marked; values: of the metric, nan where a run diverged."""
    return Marked(
        shown=np.flatnonzero(np.isfinite(values[:JUDGED])),
        diverged=np.flatnonzero(result.diverged[:JUDGED]),
        worst=np.argpartition(np.nan_to_num(values, nan=-np.inf), -WORST)[-WORST:],
        typical=result.typical(metric),
    )


def _scale(values: Floats) -> Scale:
    """Logarithmic where nearly all values spread over more than a decade."""
    low, high = np.quantile(values, [0.01, 0.99])
    return "log" if values.min() > 0 and high > SPREAD / 2 * low else "linear"


def _over_one(axes: Axes, x: Floats, y: Floats, runs: Marked, scale: Scale) -> None:
    """The metric y over one entry x: a dot for each run, their trend, and the runs marked."""
    shown, diverged = runs.shown, runs.diverged
    alpha = min(0.6, 20 / np.sqrt(shown.size))
    axes.set_yscale(scale)
    axes.plot(
        x[shown], y[shown], ".", color=ink.ESTIMATE, markersize=3, markeredgewidth=0, alpha=alpha,
        rasterized=True,
    )  # fmt: skip
    _trend(axes, x[shown], y[shown])
    _mark(axes, x, y, runs)
    if diverged.size:
        axes.plot(
            x[diverged],
            np.full(diverged.size, 0.02),
            "|",
            color=ink.PRINTED,
            transform=axes.get_xaxis_transform(),
            label="diverged",
        )
    axes.margins(x=0.03)


def _over_both(axes: Axes, x: Floats, y: Floats, values: Floats, runs: Marked, scale: Scale) -> Any:
    """The median of the metric over two entries, in hexagons; returned for a colour bar."""
    hexagons = axes.hexbin(
        x[runs.shown],
        y[runs.shown],
        values[runs.shown],
        gridsize=int(np.clip(np.sqrt(runs.shown.size) / 3, 8, 30)),
        norm=scale,
        reduce_C_function=np.median,
        cmap="viridis_r",
        edgecolors="none",
    )
    if runs.diverged.size:
        axes.plot(x[runs.diverged], y[runs.diverged], ".", color=ink.PRINTED, label="diverged")
    _mark(axes, x, y, runs)
    axes.margins(0.03)
    return hexagons


def _mark(axes: Axes, x: Floats, y: Floats, runs: Marked) -> None:
    """Mark the worst runs and the median one."""
    axes.plot(x[runs.worst], y[runs.worst], "x", color=ink.PRINTED, label="worst", zorder=5)
    typical = x[runs.typical], y[runs.typical]
    axes.plot(*typical, "*", color=ink.OTHER, markersize=11, label="median run", zorder=5)


def _trend(axes: Axes, x: Floats, y: Floats) -> None:
    """Median and 95 % of y among neighbours in x."""
    groups = min(24, max(1, x.size // 40))
    split = np.array_split(np.argsort(x, kind="stable"), groups)
    neighbours = [group for group in split if group.size]
    centre = [np.median(x[group]) for group in neighbours]
    for share, colour, name in ((0.5, ink.TRUTH, "median"), (0.95, ink.READING, "95 %")):
        values = [np.quantile(y[group], share) for group in neighbours]
        axes.plot(centre, values, color=colour, label=name)
