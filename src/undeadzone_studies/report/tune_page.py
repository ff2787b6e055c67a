"""Page of a tuning: the tuned numbers, their value on held-out runs, and the search, with
figures.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np

from undeadzone.report import html, ink
from undeadzone.report.style import DASHED, create_panels, escape_formulas, finish_panel
from undeadzone.util import toml
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.words import describe_metric
from undeadzone_studies.tuning.parameters import Parameter
from undeadzone_studies.tuning.result import Tuned
from undeadzone_studies.tuning.tune import Sweep, sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CAPTIONS: Final = {
    "history": "Left: what each candidate costs on the runs tuned on, and the best so far. Right: "
    "the scenario as it was and tuned on held-out runs, with 95 % intervals.",
    "around": "The metric on held-out runs as one number moves and the others stay. A flat curve "
    "is a number that hardly matters.",
}
COLOURS: Final = {
    "start": ink.TRUTH,
    "global": ink.READING,
    "gradient": ink.REFERENCE,
    "local": ink.OTHER,
}
HELD_OUT: Final = (
    "Held-out runs are others than those tuned on: they show the worth of the numbers. In "
    "brackets: 95 % intervals."
)
POINTS: Final = 25  # of a curve around the tuned numbers
COLUMNS: Final = 3
STEEP: Final = 20  # times the least cost, beyond which a curve is cut off


def write_tuned(result: Tuned, folder: Path, origin: html.Origin | None) -> list[Path]:
    """Write history.svg, around.svg and report.html to a folder. Raises FileError.

    Args:
        result: result to show.
        folder: folder of the files (created if needed).
        origin: data to compute the same again (None: unknown).

    Returns:
        The paths of the files.
    """
    drawn = {"history": history(result), "around": plot_sweeps(result, sweep_each_number(result))}
    return html.write_page(drawn, folder, lambda images: tune_page(result, images, origin))


def tune_page(result: Tuned, images: dict[str, bytes], origin: html.Origin | None) -> str:
    """Return the page (images: SVGs by name, else see `write_tuned`)."""
    pictures = html.encode_pictures(images, CAPTIONS)
    blocks = result.blocks()
    pairs: Any = blocks[0]
    verdict = [html.choose_verdict(result.improved, *[pairs["change"]] * 2)]
    if result.margin is not None:
        verdict.append(html.choose_verdict(result.certified, "certified", "not certified"))
    numbers = {name: each for name, each in result.summary().items() if name != "history"}
    first, *rest = html.answer_tables(blocks)
    return html.build_page(
        f"Tuned: {result.scenario.title}",
        html.verdict_line(*verdict),
        html.build_section("Numbers", first, *html.pick_pictures(pictures, "history")),
        html.build_section("Their worth", *rest, html.build_paragraph(HELD_OUT)),
        html.build_section("Around the best numbers", *html.pick_pictures(pictures, "around")),
        html.build_section(
            "The tuned scenario",
            html.fold_section("tuned.toml", html.source_html(toml.to_toml(result.scenario))),
            html.fold_numbers(numbers),
        ),
        origin=origin,
    )


def sweep_each_number(result: Tuned) -> dict[str, Sweep]:
    """Return the metric of the first scenario on held-out runs, over each tuned number alone."""
    what = msgspec.structs.replace(result.what, runs=result.what.held_out, seed=result.seed + 1)
    sweeps = {}
    for parameter, value in zip(result.parameters, result.values, strict=True):
        places = {parameter.name: _sweep_places(parameter, value)}
        sweeps[parameter.name] = sweep(result.scenario, places, what)
    return sweeps


def history(result: Tuned) -> Figure:
    """Return every candidate in order, and the scenario before and after on held-out runs."""
    rows = [["trials", "trials", "trials", "held_out"]]
    figure, panels = create_panels(rows, f"{result.scenario.title}: tuned", height=3.6)
    candidates(panels["trials"], result)
    _draw_comparison(panels["held_out"], result)
    finish_panel(panels["held_out"], "On held-out runs", _describe_objective(result), "", legend=0)
    return figure


def candidates(axes: Axes, result: Tuned) -> None:
    """Draw the cost of every candidate by its stage of the search, and the best so far.

    Those that are not certified are crossed out.
    """
    cost = np.array([trial.cost for trial in result.trials])
    certified = np.array([not trial.margin < result.what.margin for trial in result.trials])
    best = np.minimum.accumulate(np.where(certified, cost, np.inf))
    known = best[np.isfinite(best)]
    top = 1.15 * max(float(known.max(initial=0.0)), result.cost[0])
    clipped = np.minimum(cost, top)
    for stage, colour in COLOURS.items():
        tried = np.flatnonzero([trial.stage == stage for trial in result.trials])
        if tried.size:
            axes.plot(tried, clipped[tried], ".", color=colour, markersize=5, label=stage)
    if not certified.all():
        lost = np.flatnonzero(~certified)
        small: Any = {"markersize": 3.5, "alpha": 0.6}
        axes.plot(lost, clipped[lost], "x", color=ink.PRINTED, label="not certified", **small)
    axes.plot(best, color=ink.ESTIMATE, drawstyle="steps-post", label="best so far")
    _use_log_axis(axes, known)
    finish_panel(
        axes, "Candidates, on the runs tuned on", _describe_objective(result), "candidate", legend=3
    )


def plot_sweeps(result: Tuned, sweeps: dict[str, Sweep]) -> Figure:
    """Return the metric over each tuned number, on held-out runs (sweeps: from
    `sweep_each_number`).
    """
    names = list(sweeps)
    rows = [names[i : i + COLUMNS] for i in range(0, len(names), COLUMNS)]
    rows[-1] += [rows[-1][-1]] * (len(rows[0]) - len(rows[-1]))
    title = "Around the best numbers, on held-out runs, the other numbers unchanged"
    figure, panels = create_panels(rows, title, height=3.0)
    for parameter, value in zip(result.parameters, result.values, strict=True):
        axes = panels[parameter.name]
        _draw_sweep(axes, parameter, value, sweeps[parameter.name], result.what.margin)
        finish_panel(
            axes, escape_formulas(parameter.name), _describe_objective(result), legend=2, x_label=""
        )
    return figure


def _draw_sweep(
    axes: Axes, parameter: Parameter, value: float, curve: Sweep, margin: float
) -> None:
    """Draw the metric over a number (margin: the least margin of a certificate)."""
    (x,) = curve.axes.values()
    cost = curve.cost
    axes.set_xscale("log" if parameter.log else "linear")
    plotted = np.isfinite(cost) & (cost < STEEP * cost.min())
    axes.plot(x[plotted], cost[plotted], ".-", color=ink.ESTIMATE)
    lost = plotted & (curve.margin < margin)
    if lost.any():
        axes.plot(x[lost], cost[lost], "x", color=ink.PRINTED, label="not certified")
    start = parameter.start
    axes.axvline(value, color=ink.REFERENCE, label=f"tuned {value:.4g}")
    axes.axvline(start, color=ink.ZONE, linestyle=DASHED, label=f"start {start:.4g}")
    axes.set_xlim(parameter.low, parameter.high)
    _use_log_axis(axes, cost[plotted])


def _describe_objective(result: Tuned) -> str:
    """Return the statistic and the metric of the tuning."""
    return f"{result.what.statistic} {describe_metric(result.what.metric)}"


def _sweep_places(parameter: Parameter, value: float) -> Floats:
    """Return the tuned number, and a grid over its range."""
    return np.unique(np.append(parameter.value_at_share(np.linspace(0.0, 1.0, POINTS)), value))


def _draw_comparison(axes: Axes, result: Tuned) -> None:
    """Draw the first scenario on held-out runs as it was and tuned, with intervals."""
    first = result.held_out[0]
    pairs = (first.before, ink.TRUTH), (first.after, ink.ESTIMATE)
    for place, (worth, colour) in enumerate(pairs):
        value, low, high = worth.value
        reach = [[_whisker_length(low, value)], [_whisker_length(high, value)]]
        axes.errorbar([place], [value], yerr=reach, fmt="o", capsize=5, color=colour)
    axes.set_xticks([0, 1], ["before", "tuned"])
    axes.set_xlim(-0.6, 1.6)
    axes.set_ylim(bottom=0.0)
    axes.margins(y=0.2)


def _whisker_length(end: float, value: float) -> float:
    """Return the distance of an interval's end from its value, 0 for an infinite end."""
    return abs(end - value) if np.isfinite(end) else 0.0


def _use_log_axis(axes: Axes, values: Floats) -> None:
    """Set a logarithmic axis if values span more than a decade."""
    if values.size and values.min() > 0 and values.max() > 10 * values.min():
        axes.set_yscale("log")
