"""Figures of an ensemble: distributions of its metrics, and quantiles over time."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError
from undeadzone.report import ink
from undeadzone.report.style import (
    DASHED,
    axis_label,
    create_panels,
    escape_formulas,
    finish_panel,
    log_axis_floor,
)
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.result import JUDGED, MAIN, WIDTHS, Ensemble
from undeadzone_studies.ensemble.words import describe_metric
from undeadzone_studies.statistics.intervals import LEVEL, share_bounds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKS: Final = {
    "median": (0.5, ink.TRUTH),
    "95 %": (0.95, ink.READING),
    "99 %": (0.99, ink.PRINTED),
}
SPREAD: Final = 20  # beyond this ratio of the 99.5 % to the 0.5 % quantile an axis is logarithmic


def plot_distributions(result: Ensemble) -> Figure:
    """Return histograms of errors, settling times and widths.

    Histograms with median, 95 % and 99 % stand above the share of runs beyond each value.
    """
    from matplotlib.ticker import NullFormatter

    names = _metrics_to_show(result)
    rows = [[f"above {name}" for name in names], [f"below {name}" for name in names]]
    title = f"{result.info.title}: {_describe_runs(result)}"
    figure, panels = create_panels(rows, title, width=13.0, height=3.0)
    for name in names:
        above = panels[f"above {name}"]
        below = panels[f"below {name}"]
        ordered = np.sort(result.sample(name))
        _draw_histogram(above, ordered)
        _draw_exceedance(below, ordered)
        below.set_xscale(above.get_xscale())
        for axes in (above, below):
            axes.xaxis.set_minor_formatter(NullFormatter())
        below.set_xlim(above.get_xlim())
        of_bins = ""
        of_runs = ""
        if name == names[0]:
            of_bins = "share of runs in each bin [%]"
            of_runs = "share of runs beyond it"
        quantity = describe_metric(name, result.info.duration)
        finish_panel(above, quantity[:1].upper() + quantity[1:], of_bins, "", legend=2)
        finish_panel(below, "", of_runs, axis_label(quantity, result.unit(name)), legend=0)
    return figure


def first_of_ensemble(result: Ensemble) -> Figure:
    """Return the first figure of an ensemble.

    Raises InputError if every run diverged and none was recorded.
    """
    if not result.diverged[result.independent].all():
        return plot_distributions(result)
    figure = plot_bands(result)
    if figure is None:
        raise InputError("plot: every run of this ensemble diverged, and none was recorded")
    return figure


def distribution(axes: Axes, result: Ensemble) -> None:
    """Draw the distribution of the runs' errors."""
    _draw_histogram(axes, np.sort(result.sample(MAIN)))
    quantity = axis_label(describe_metric(MAIN, result.info.duration), result.unit(MAIN))
    finish_panel(axes, _describe_runs(result), "share of runs in each bin [%]", quantity, legend=2)


def _metrics_to_show(result: Ensemble) -> list[str]:
    """Return the metrics to plot as distributions, settling times only if some run settled."""
    names = ["rms_tracking", "peak_tracking"]
    for name in ("rms_behind_play", "rms_tip"):
        if name in result.metrics:
            names.insert(0, name)
    if result.settled[result.independent].any():
        names.append("settling_time")
    if np.any(result.sample(WIDTHS)):
        names.append(WIDTHS)
    return names


def _describe_runs(result: Ensemble) -> str:
    """Return the numbers of all runs, of independent runs and of diverged runs, as text."""
    independent = result.diverged[result.independent]
    parts = [f"{result.info.runs:,} runs"]
    if independent.size < result.info.runs:
        parts.append(f"the {independent.size:,} independent ones")
    if independent.any():
        parts.append(f"{independent.sum():,} diverged and are left out")
    return ", ".join(parts)


def _draw_histogram(axes: Axes, ordered: Floats) -> None:
    """Draw a histogram of ordered values and its quantiles (infinite values never settled)."""
    bounded = ordered[np.isfinite(ordered)]
    edges, logarithmic = bin_edges(bounded)
    if logarithmic:
        axes.set_xscale("log")
    share = 100 * np.histogram(bounded, edges)[0] / ordered.size
    axes.stairs(share, edges, fill=True, color=ink.ESTIMATE, alpha=0.35, linewidth=0)
    for name, (q, colour) in MARKS.items():
        place = ordered[int(np.ceil(q * ordered.size)) - 1]
        words = f"{name} {place:.3g}" if np.isfinite(place) else f"{name} never"
        line = ([place] * 2, [0, float(share.max())])
        style = "-" if q == 0.5 else DASHED
        axes.plot(*line, color=colour, linewidth=1.6, linestyle=style, label=words)
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0, 1.05 * share.max())


def bin_edges(bounded: Floats) -> tuple[Floats, bool]:
    """Return the edges of a histogram's bins over ordered values, and whether they are
    logarithmic.
    """
    low, high = (float(np.quantile(bounded, q)) for q in (0.005, 0.995))
    bins = int(np.clip(2 * bounded.size ** (1 / 3), 10, 80))  # Rice's rule
    reach = high - low
    if low > 0 and high > SPREAD * low:
        return np.geomspace(max(bounded[0], low / 100), bounded[-1], bins + 1), True
    if reach > 1e-9 * abs(high):
        first = max(bounded[0], low - 0.15 * reach)
        last = min(bounded[-1], high + 0.15 * reach)
        return np.linspace(first, last, bins + 1), False
    return high + 0.1 * (abs(high) or 1.0) * np.linspace(-1, 1, bins), False


def _draw_exceedance(axes: Axes, ordered: Floats) -> None:
    """Draw the share of runs above each value, within the interval of Clopper and Pearson."""
    n = ordered.size
    above = np.unique(np.geomspace(1, max(n - 1, 1), 300).astype(int))[::-1]  # numbers of runs
    x = ordered[np.maximum(n - 1 - above, 0)]
    axes.set_yscale("log")
    low, high = share_bounds(above, n)
    axes.fill_between(x, low, high, color=ink.ESTIMATE, alpha=0.25, linewidth=0)
    axes.plot(x, above / n, color=ink.ESTIMATE)
    axes.set_ylim(0.5 / n, 1.5)


def plot_bands(result: Ensemble) -> Figure | None:
    """Return median, 5-95 % and 1-99 % of the recorded runs over time, or None without recorded
    runs.

    Shown are |z - r| and the errors of the widths.
    """
    if result.bands is None:
        return None
    quantiles = result.bands.quantiles
    t = result.bands.t
    errors = [name for name in quantiles if name.startswith("tracking[")]
    outputs = (len(quantiles) - len(errors)) // 2  # two widths each
    rows = [[name] * 2 for name in errors]
    rows += [[f"d_right[{i}]", f"d_left[{i}]"] for i in range(outputs)]
    title = f"{result.info.title}: the first {result.info.recorded:,} runs over time"
    figure, panels = create_panels(rows, title, height=2.9)
    unit = result.info.units.output
    for name, axes in panels.items():
        quantity, _, output = name.rstrip("]").partition("[")
        of = f" of output {output}" if outputs > 1 else ""
        q = _bound_infinite(quantiles[name])
        if quantity == "tracking":
            axes.set_yscale("log")
            _draw_band(axes, t, np.maximum(q, log_axis_floor(q[:, 1])))
            finish_panel(axes, f"Tracking error{of}", axis_label("|z − r|", unit))
        else:
            _draw_band(axes, t, q)
            axes.axhline(0.0, color=ink.TRUTH, linewidth=0.7)
            # d_r of d_right
            d = quantity[:3]
            edge = quantity[2:]
            error = rf"$\hat {d} - {d}$"
            finish_panel(axes, f"Error of the {edge} width{of}", axis_label(error, unit))
    return figure


def _bound_infinite(q: Floats) -> Floats:
    """Return infinite quantiles, of runs that diverged, clipped above all finite quantiles."""
    largest = float(np.abs(q[np.isfinite(q)]).max(initial=1e-12))
    return np.clip(q, -1.05 * largest, 1.05 * largest)


def _draw_band(axes: Axes, t: Floats, q: Floats) -> None:
    """Draw the median in the bands between quantiles (N x 5): 1, 5, 50, 95 and 99 %."""
    shade: Any = {"color": ink.ESTIMATE, "linewidth": 0}
    axes.fill_between(t, q[:, 0], q[:, 4], alpha=0.18, label="1–99 %", **shade)
    axes.fill_between(t, q[:, 1], q[:, 3], alpha=0.35, label="5–95 %", **shade)
    axes.plot(t, q[:, 2], color=ink.TRUTH, linewidth=1.1, label="median")


# --- What decides: which entries count


Sensitivities: TypeAlias = Mapping[str, dict[str, Any]]  # by entry, as in `Ensemble.summary`
Index: TypeAlias = Mapping[str, float]  # of one entry: value, low and high of its interval
Scale = Literal["log", "linear"]
ROWS: Final = 12  # entries in the tornado
WORST: Final = 20  # runs that are marked


class MarkedRuns(NamedTuple):
    """Numbers of runs: with a finite metric, diverged, worst, and the median run.

    Of runs beyond the first `JUDGED` only the worst are plotted.
    """

    finite: npt.NDArray[np.intp]
    diverged: npt.NDArray[np.intp]
    worst: npt.NDArray[np.intp]
    typical: int | None


def plot_tornado(sensitivities: Sensitivities) -> Figure | None:
    """Return partial rank correlation and Sobol indices, the most influential entry on top.

    Args:
        sensitivities: of the entries, as in a summary (None is returned if there are none)
    """
    if not sensitivities:
        return None
    names = list(sensitivities)[:ROWS]
    title = f"What decides the {describe_metric(MAIN)}"
    height = 1.6 + 0.34 * len(names)
    figure, panels = create_panels([["rank", "share"]], title, height=height)
    rank = panels["rank"]
    share = panels["share"]
    _draw_ranks(rank, [sensitivities[name]["partial"] for name in names])
    _draw_shares(share, [sensitivities[name] for name in names])
    _name_rows(share, [""] * len(names))
    _name_rows(rank, [fill(escape_formulas(name), 30) for name in names])
    ranked = "More of it is worse (right) or better (left)"
    finish_panel(rank, ranked, "", "partial rank correlation", legend=0)
    finish_panel(share, "Share of the variance that comes from it", "", "Sobol index", legend=3)
    rank.set_ylim(share.get_ylim())
    return figure


def _name_rows(axes: Axes, names: list[str]) -> None:
    """Set a row for each name, the first on top."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def _draw_ranks(axes: Axes, partial: list[dict[str, float]]) -> None:
    """Draw bars of partial rank correlations."""
    _draw_bars(axes, 0.0, 0.62, partial, color=list(map(_rank_colour, partial)))
    axes.axvline(0.0, color=ink.TRUTH, linewidth=0.8)
    axes.set_xlim(-1.05, 1.05)


def _rank_colour(index: Index) -> str:
    """Return grey if an index may be chance, else a colour by sign."""
    if index["p"] > 1 - LEVEL:
        return ink.ZONE
    return ink.PRINTED if index["value"] > 0 else ink.ESTIMATE


def _draw_shares(axes: Axes, sensitivities: list[dict[str, Any]]) -> None:
    """Draw bars of Sobol indices: alone, and with interactions if known."""
    first = [each["first_order"] for each in sensitivities]
    total = [each["total_order"] for each in sensitivities]
    if total[0] is None:
        _draw_bars(axes, 0.0, 0.62, first, color=ink.REFERENCE, label="alone")
        floor = sensitivities[0]["floor"]
        axes.axvline(floor, color=ink.ZONE, linestyle=(0, (3, 2)), label="chance")
    else:
        _draw_bars(axes, -0.16, 0.31, first, color=ink.REFERENCE, label="alone")
        _draw_bars(axes, 0.16, 0.31, total, color=ink.OTHER, label="with interactions")
    largest = max(index["high"] for index in first + total if index is not None)
    axes.set_xlim(0.0, min(1.02, 0.02 + 1.08 * largest))


def _draw_bars(
    axes: Axes, shift: float, thick: float, indices: list[dict[str, float]], **style: Any
) -> None:
    """Draw a bar with its interval for each index."""
    places = np.arange(len(indices)) + shift
    values = [index["value"] for index in indices]
    below = [index["value"] - index["low"] for index in indices]
    above = [index["high"] - index["value"] for index in indices]
    whisker = {"elinewidth": 1.0, "ecolor": ink.TRUTH, "capsize": 2.0}
    axes.barh(places, values, thick, xerr=[below, above], error_kw=whisker, alpha=0.75, **style)


def plot_influence(result: Ensemble, sensitivities: Sensitivities) -> Figure | None:
    """Return the main metric over each of the two most influential entries, and over both.

    The worst runs, the median one and those that diverged are marked.

    Args:
        result: of which runs are plotted
        sensitivities: of its entries, as in a summary (None is returned if there are none)
    """
    if not sensitivities:
        return None
    names = list(sensitivities)[:2]
    two = len(names) == 2
    rows = [[*names, "both"] if two else names]
    width = 13.0 if two else 6.5
    figure, panels = create_panels(rows, "The most influential entries", width=width, height=4.4)
    values = np.where(result.diverged, np.nan, result.column(MAIN))
    runs = _runs_to_mark(result, values)
    scale = _choose_scale(values[runs.finite])
    quantity = axis_label(describe_metric(MAIN, result.info.duration), result.unit(MAIN))
    labels = [axis_label(escape_formulas(name), result.unit(name)) for name in names]
    for name, x_label in zip(names, labels, strict=True):
        _draw_over_entry(panels[name], result.column(name), values, runs, scale)
        finish_panel(panels[name], f"Over {name}", quantity, x_label, legend=3)
    if two:
        both = panels["both"]
        x, y = map(result.column, names)
        colours = _draw_over_entries(both, x, y, values, runs, scale)
        figure.colorbar(colours, ax=both, pad=0.02).set_label(f"median of the {quantity}")
        finish_panel(both, "Over both", labels[1], labels[0], legend=3)
    return figure


def _runs_to_mark(result: Ensemble, values: Floats) -> MarkedRuns:
    """Return the runs to mark (values: of the main metric, nan for a diverged run)."""
    return MarkedRuns(
        finite=np.flatnonzero(np.isfinite(values[:JUDGED])),
        diverged=np.flatnonzero(result.diverged[:JUDGED]),
        worst=np.argpartition(np.nan_to_num(values, nan=-np.inf), -WORST)[-WORST:],
        typical=result.typical(),
    )


def _choose_scale(values: Floats) -> Scale:
    """Return a logarithmic scale if nearly all values spread over more than a decade, else
    linear.
    """
    low, high = np.quantile(values, [0.01, 0.99])
    return "log" if values.min() > 0 and high > SPREAD / 2 * low else "linear"


def _draw_over_entry(axes: Axes, x: Floats, y: Floats, runs: MarkedRuns, scale: Scale) -> None:
    """Draw the metric y over an entry x: a dot for each run, their trend, and the marked runs."""
    finite = runs.finite
    diverged = runs.diverged
    alpha = min(0.6, 20 / np.sqrt(finite.size))
    axes.set_yscale(scale)
    dots: Any = {"markersize": 3, "markeredgewidth": 0, "rasterized": True}
    axes.plot(x[finite], y[finite], ".", color=ink.ESTIMATE, alpha=alpha, **dots)
    _draw_trend(axes, x[finite], y[finite])
    _mark_runs(axes, x, y, runs)
    if diverged.size:
        at_bottom = axes.get_xaxis_transform()
        low = np.full(diverged.size, 0.02)
        axes.plot(x[diverged], low, "|", color=ink.PRINTED, transform=at_bottom, label="diverged")
    axes.margins(x=0.03)


def _draw_over_entries(
    axes: Axes, x: Floats, y: Floats, values: Floats, runs: MarkedRuns, scale: Scale
) -> Any:
    """Draw the median of the metric over two entries, in hexagons, and return it for a colour
    bar.
    """
    points = x[runs.finite], y[runs.finite], values[runs.finite]
    size = int(np.clip(np.sqrt(runs.finite.size) / 3, 8, 30))
    looks: Any = {"norm": scale, "cmap": "viridis_r", "edgecolors": "none"}
    hexagons = axes.hexbin(*points, gridsize=size, reduce_C_function=np.median, **looks)
    if runs.diverged.size:
        axes.plot(x[runs.diverged], y[runs.diverged], ".", color=ink.PRINTED, label="diverged")
    _mark_runs(axes, x, y, runs)
    axes.margins(0.03)
    return hexagons


def _mark_runs(axes: Axes, x: Floats, y: Floats, runs: MarkedRuns) -> None:
    """Mark the worst runs and the median run."""
    axes.plot(x[runs.worst], y[runs.worst], "x", color=ink.PRINTED, label="worst", zorder=5)
    typical = x[runs.typical], y[runs.typical]
    axes.plot(*typical, "*", color=ink.OTHER, markersize=11, label="median run", zorder=5)


def _draw_trend(axes: Axes, x: Floats, y: Floats) -> None:
    """Draw median and 95 % of y among neighbours in x."""
    groups = min(24, max(1, x.size // 40))
    split = np.array_split(np.argsort(x, kind="stable"), groups)
    neighbours = [group for group in split if group.size]
    centre = [np.median(x[group]) for group in neighbours]
    for share, colour, name in ((0.5, ink.TRUTH, "median"), (0.95, ink.READING, "95 %")):
        values = [np.quantile(y[group], share) for group in neighbours]
        axes.plot(centre, values, color=colour, label=name)
