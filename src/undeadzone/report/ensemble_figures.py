"""Figures of an ensemble: how its metrics are distributed, what most runs do over time, and which entries decide."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np

from undeadzone.ensemble.result import JUDGED, MAIN, WIDTHS, Ensemble
from undeadzone.report.style import (
    ESTIMATE,
    FLOOR,
    OTHER,
    PRINTED,
    READING,
    REFERENCE,
    TRUTH,
    ZONE,
    finish,
    label,
    sheet,
)
from undeadzone.statistics.intervals import LEVEL
from undeadzone.support.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Found = Mapping[str, dict[str, Any]]  # sensitivities, as in `Ensemble.summary`
Scale = Literal["log", "linear"]
WORDS: Final = {
    "rms_tracking": "rms of z − r over the last 2 s",
    "rms_estimation": "rms of z − z^ over the last 2 s",
    "rms_tip": "rms distance of the tip from its path over the last 2 s",
    "peak_tracking": "largest |z − r|",
    "settling_time": "settling time",
    "silent_fraction": "share of silent samples",
    "rms_input": "rms of u",
    WIDTHS: "largest |d^ − d| at the end",
}
MARKS: Final = {"median": (0.5, TRUTH), "95 %": (0.95, READING), "99 %": (0.99, PRINTED)}
SPREAD: Final = 20  # beyond this ratio of the 99.5 % to the 0.5 % quantile an axis is logarithmic
ROWS: Final = 12  # entries in the tornado
WORST: Final = 20  # runs that are marked


def distributions(result: Ensemble) -> Figure:
    """Histograms with median, 95 % and 99 %, and the share of runs beyond each value, of errors, settling time and widths."""
    from matplotlib.ticker import NullFormatter

    shown = (
        ["rms_tip"] * ("rms_tip" in result.metrics)
        + ["rms_tracking", "peak_tracking"]
        + ["settling_time"] * bool(result.settled[result.independent].any())
    )
    shown += [WIDTHS] * bool(np.any(result.sample(WIDTHS)))
    figure, panels = sheet(
        [[f"{row} {name}" for name in shown] for row in ("above", "below")],
        f"{result.info.title}: {_runs(result)}",
        width=13.0,
        height=3.0,
    )
    for name in shown:
        above, below = panels[f"above {name}"], panels[f"below {name}"]
        ordered = np.sort(result.sample(name))
        _histogram(above, ordered)
        _beyond(below, ordered)
        below.set_xscale(above.get_xscale())
        for axes in (above, below):
            axes.xaxis.set_minor_formatter(NullFormatter())
        below.set_xlim(above.get_xlim())
        first = name == shown[0]
        finish(
            above,
            WORDS[name][:1].upper() + WORDS[name][1:],
            "share of runs in each bin [%]" * first,
            "",
            legend=2,
        )
        finish(
            below,
            "",
            "share of runs beyond it" * first,
            label(WORDS[name], result.unit(name)),
            legend=0,
        )
    return figure


def _histogram(axes: Axes, ordered: Floats) -> None:
    """Infinite values are runs that never settled."""
    bounded = ordered[np.isfinite(ordered)]
    low, high = (float(np.quantile(bounded, q)) for q in (0.005, 0.995))
    bins = int(np.clip(2 * bounded.size ** (1 / 3), 10, 80))  # Rice's rule
    reach = high - low
    if low > 0 and high > SPREAD * low:
        axes.set_xscale("log")
        edges = np.geomspace(max(bounded[0], low / 100), bounded[-1], bins + 1)
    elif reach > 1e-9 * abs(high):
        edges = np.linspace(
            max(bounded[0], low - 0.15 * reach), min(bounded[-1], high + 0.15 * reach), bins + 1
        )
    else:
        edges = high + 0.1 * (abs(high) or 1.0) * np.linspace(-1, 1, bins)
    share = 100 * np.histogram(bounded, edges)[0] / ordered.size
    axes.stairs(share, edges, fill=True, color=ESTIMATE, alpha=0.35, linewidth=0)
    for name, (q, colour) in MARKS.items():
        place = ordered[int(np.ceil(q * ordered.size)) - 1]
        words = f"{name} {place:.3g}" if np.isfinite(place) else f"{name} never"
        axes.plot(
            [place] * 2,
            [0, share.max()],
            color=colour,
            linewidth=1.6,
            linestyle="-" if q == 0.5 else (0, (4, 2)),
            label=words,
        )
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0, 1.05 * share.max())


def _beyond(axes: Axes, ordered: Floats) -> None:
    """The share of runs above each value, within the interval of Clopper and Pearson."""
    from scipy.special import betaincinv

    n = ordered.size
    above = np.unique(np.geomspace(1, max(n - 1, 1), 300).astype(int))[::-1]
    x = ordered[np.maximum(n - 1 - above, 0)]
    low, high = (
        betaincinv(above, n - above + 1, (1 - LEVEL) / 2),
        betaincinv(above + 1, np.maximum(n - above, 1), (1 + LEVEL) / 2),
    )
    axes.set_yscale("log")
    axes.fill_between(x, low, high, color=ESTIMATE, alpha=0.25, linewidth=0)
    axes.plot(x, above / n, color=ESTIMATE)
    axes.set_ylim(0.5 / n, 1.5)


def over_time(result: Ensemble) -> Figure | None:
    """Median, 5-95 % and 1-99 % of the recorded runs over time: |z - r| and the errors of the widths; None without them."""
    if result.bands is None:
        return None
    found = result.bands.quantiles
    errors = [name for name in found if name.startswith("tracking[")]
    widths = [name for name in found if name not in errors]
    outputs = len(widths) // 2
    rows = [[name] * 2 for name in errors] + [
        [f"d_right[{i}]", f"d_left[{i}]"] for i in range(outputs)
    ]
    figure, panels = sheet(
        rows, f"{result.info.title}: the first {result.info.recorded:,} runs over time", height=2.9
    )
    unit = result.info.units.output
    for name, axes in panels.items():
        what, _, output = name.rstrip("]").partition("[")
        of = f" of output {output}" if outputs > 1 else ""
        q = _bounded(found[name])
        if what == "tracking":
            floor = max(FLOOR, float(np.quantile(q[:, 1], 0.03)) / 10)
            axes.set_yscale("log")
            _band(axes, result.bands.t, np.maximum(q, floor))
            finish(axes, f"Tracking error{of}", label("|z − r|", unit))
        else:
            edge = what.removeprefix("d_")
            _band(axes, result.bands.t, q)
            axes.axhline(0.0, color=TRUTH, linewidth=0.7)
            finish(
                axes,
                f"Error of the {edge} width{of}",
                label(rf"$\hat d_{edge[0]} - d_{edge[0]}$", unit),
            )
    return figure


def _bounded(q: Floats) -> Floats:
    """Infinite quantiles, of runs that diverged, out of sight above all others."""
    largest = float(np.abs(q[np.isfinite(q)]).max(initial=1e-12))
    return np.clip(q, -1.05 * largest, 1.05 * largest)


def _band(axes: Axes, t: Floats, q: Floats) -> None:
    axes.fill_between(t, q[:, 0], q[:, 4], color=ESTIMATE, alpha=0.18, linewidth=0, label="1–99 %")
    axes.fill_between(t, q[:, 1], q[:, 3], color=ESTIMATE, alpha=0.35, linewidth=0, label="5–95 %")
    axes.plot(t, q[:, 2], color=TRUTH, linewidth=1.1, label="median")


def tornado(found: Found, metric: str = MAIN) -> Figure | None:
    """Partial rank correlation and Sobol indices of the entries, as in a summary, the most influential on top; None if none is known."""
    if not found:
        return None
    names = list(found)[:ROWS]
    figure, panels = sheet(
        [["rank", "share"]],
        f"What decides the {WORDS.get(metric, metric)}",
        height=1.6 + 0.34 * len(names),
    )
    _ranks(panels["rank"], [found[name]["partial"] for name in names])
    _shares(panels["share"], [found[name] for name in names])
    for axes, shown in (
        (panels["share"], [""] * len(names)),
        (panels["rank"], [fill(name, 30) for name in names]),
    ):
        axes.set_yticks(range(len(names)), shown)
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.grid(visible=False, axis="y")
    finish(
        panels["rank"],
        "More of it is worse (right) or better (left)",
        "",
        "partial rank correlation",
        legend=0,
    )
    finish(panels["share"], "Share of the variance that comes from it", "", "Sobol index", legend=3)
    panels["rank"].set_ylim(panels["share"].get_ylim())
    return figure


def _ranks(axes: Axes, partial: list[dict[str, float]]) -> None:
    """Grey where it may be chance."""
    colours = [
        ZONE if c["p"] > 1 - LEVEL else PRINTED if c["value"] > 0 else ESTIMATE for c in partial
    ]
    _bars(axes, 0.0, 0.62, partial, color=colours)
    axes.axvline(0.0, color=TRUTH, linewidth=0.8)
    axes.set_xlim(-1.05, 1.05)


def _shares(axes: Axes, found: list[dict[str, Any]]) -> None:
    first, total = ([one[order] for one in found] for order in ("first_order", "total_order"))
    if total[0] is None:
        _bars(axes, 0.0, 0.62, first, color=REFERENCE, label="alone")
        axes.axvline(found[0]["floor"], color=ZONE, linestyle=(0, (3, 2)), label="chance")
    else:
        _bars(axes, -0.16, 0.31, first, color=REFERENCE, label="alone")
        _bars(axes, 0.16, 0.31, total, color=OTHER, label="with interactions")
    axes.set_xlim(
        0.0,
        min(1.02, 0.02 + 1.08 * max(index["high"] for index in first + total if index is not None)),
    )


def _bars(
    axes: Axes, shift: float, thick: float, found: list[dict[str, float]], **style: Any
) -> None:
    values = [one["value"] for one in found]
    reach = [
        [one["value"] - one["low"] for one in found],
        [one["high"] - one["value"] for one in found],
    ]
    whiskers = {"elinewidth": 1.0, "ecolor": TRUTH, "capsize": 2.0}
    axes.barh(
        np.arange(len(found)) + shift,
        values,
        thick,
        xerr=reach,
        error_kw=whiskers,
        alpha=0.75,
        **style,
    )


def influence(result: Ensemble, found: Found, metric: str = MAIN) -> Figure | None:
    """The metric over each of the two most influential entries, and over both; the worst runs, the median one and those that diverged are marked."""
    if not found:
        return None
    names = list(found)[:2]
    figure, panels = sheet(
        [[*names, "both"][: 2 * len(names) - 1]],
        "The most influential entries",
        width=13.0 if len(names) == 2 else 6.5,
        height=4.4,
    )
    values = np.where(result.diverged, np.nan, result.column(metric))
    marked = Marked(
        shown=np.flatnonzero(np.isfinite(values[:JUDGED])),
        diverged=np.flatnonzero(result.diverged[:JUDGED]),
        worst=np.argpartition(np.nan_to_num(values, nan=-np.inf), -WORST)[-WORST:],
        typical=result.typical(metric),
    )
    low, high = np.quantile(values[marked.shown], [0.01, 0.99])
    scale: Scale = "log" if values[marked.shown].min() > 0 and high > SPREAD / 2 * low else "linear"
    words = label(WORDS.get(metric, metric), result.unit(metric))
    labels = [label(name, result.unit(name)) for name in names]
    for name, x_label in zip(names, labels, strict=True):
        _over_one(panels[name], result.column(name), values, marked, scale)
        finish(panels[name], f"Over {name}", words, x_label, legend=3)
    if len(names) == 2:
        x, y = map(result.column, names)
        colours = _over_both(panels["both"], x, y, values, marked, scale)
        figure.colorbar(colours, ax=panels["both"], pad=0.02).set_label(f"median of the {words}")
        finish(panels["both"], "Over both", labels[1], labels[0], legend=3)
    return figure


class Marked(NamedTuple):
    """Numbers of runs."""

    shown: Any
    diverged: Any
    worst: Any
    typical: Any


def _over_one(axes: Axes, x: Floats, y: Floats, runs: Marked, scale: Scale) -> None:
    axes.set_yscale(scale)
    axes.plot(
        x[runs.shown],
        y[runs.shown],
        ".",
        color=ESTIMATE,
        markersize=3,
        markeredgewidth=0,
        alpha=min(0.6, 20 / np.sqrt(runs.shown.size)),
    )
    _trend(axes, x[runs.shown], y[runs.shown])
    _mark(axes, x, y, runs)
    if runs.diverged.size:
        axes.plot(
            x[runs.diverged],
            np.full(runs.diverged.size, 0.02),
            "|",
            color=PRINTED,
            transform=axes.get_xaxis_transform(),
            label="diverged",
        )
    axes.margins(x=0.03)


def _over_both(axes: Axes, x: Floats, y: Floats, values: Floats, runs: Marked, scale: Scale) -> Any:
    shown = [column[runs.shown] for column in (x, y, values)]
    found = axes.hexbin(
        *shown,
        gridsize=int(np.clip(np.sqrt(runs.shown.size) / 3, 8, 30)),
        norm=scale,
        reduce_C_function=np.median,
        cmap="viridis_r",
        edgecolors="none",
    )
    if runs.diverged.size:
        axes.plot(x[runs.diverged], y[runs.diverged], ".", color=PRINTED, label="diverged")
    _mark(axes, x, y, runs)
    axes.margins(0.03)
    return found


def _mark(axes: Axes, x: Floats, y: Floats, runs: Marked) -> None:
    axes.plot(x[runs.worst], y[runs.worst], "x", color=PRINTED, label="worst", zorder=5)
    axes.plot(
        x[runs.typical],
        y[runs.typical],
        "*",
        color=OTHER,
        markersize=11,
        label="median run",
        zorder=5,
    )


def _trend(axes: Axes, x: Floats, y: Floats) -> None:
    """Median and 95 % of y among neighbours in x."""
    parts = [
        part
        for part in np.array_split(np.argsort(x, kind="stable"), min(24, max(1, x.size // 40)))
        if part.size
    ]
    centre = [np.median(x[part]) for part in parts]
    for share, colour, name in ((0.5, TRUTH, "median"), (0.95, READING, "95 %")):
        axes.plot(centre, [np.quantile(y[part], share) for part in parts], color=colour, label=name)


def words(quantity: str) -> str:
    """What a metric or the error of a width is, in words."""
    edge, _, output = quantity.partition("_error[")
    return WORDS.get(
        quantity, f"{edge[:3]}^ − {edge[:3]}, output {output[:-1]}" if output else quantity
    )


def _runs(result: Ensemble) -> str:
    judged = result.diverged[result.independent]
    words = f"{result.info.runs:,} runs" + (
        f", the {judged.size:,} independent ones" if judged.size < result.info.runs else ""
    )
    return words + (f", {judged.sum():,} diverged and are left out" if judged.any() else "")
