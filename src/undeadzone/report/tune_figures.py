"""Figures of a tuning: the search, what it is worth on held-out runs, and the metric around what was found."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np

from undeadzone.report.ensemble_figures import WORDS
from undeadzone.report.style import (
    ESTIMATE,
    OTHER,
    PRINTED,
    READING,
    REFERENCE,
    TRUTH,
    ZONE,
    finish,
    sheet,
    write,
)
from undeadzone.support.arrays import Floats
from undeadzone.tuning.parameters import Parameter
from undeadzone.tuning.result import Tuned
from undeadzone.tuning.sweep import Sweep, sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = {"start": TRUTH, "global": READING, "gradient": REFERENCE, "local": OTHER}
POINTS: Final = 25  # of a curve around the numbers found
COLUMNS: Final = 3


def write_figures(result: Tuned, folder: Path) -> list[Path]:
    """history.png and around.png."""
    return [
        write(history(result), folder / "history.png"),
        write(around(result, slices(result)), folder / "around.png"),
    ]


def slices(result: Tuned) -> dict[str, Sweep]:
    """The metric of the first scenario on held-out runs over each tuned number, the others as they were found."""
    what = msgspec.structs.replace(result.what, runs=result.what.held_out, seed=result.seed + 1)
    return {
        p.name: sweep(result.scenario, {p.name: _places(p, value)}, what)
        for p, value in zip(result.parameters, result.values, strict=True)
    }


def history(result: Tuned) -> Figure:
    """Every candidate in order, the best so far, and the scenario before and after on held-out runs."""
    figure, panels = sheet(
        [["trials", "trials", "trials", "held_out"]], f"{result.scenario.title}: tuned", height=3.6
    )
    axes, words = (
        panels["trials"],
        f"{result.what.statistic} {WORDS.get(result.what.metric, result.what.metric)}",
    )
    cost = np.array([trial.cost for trial in result.trials])
    kept = np.array([not trial.margin < result.what.margin for trial in result.trials])
    best = np.minimum.accumulate(np.where(kept, cost, np.inf))
    top = 1.15 * max(float(best[np.isfinite(best)].max(initial=0.0)), result.cost[0])
    for stage, colour in COLOURS.items():
        chosen = np.flatnonzero([trial.stage == stage for trial in result.trials])
        if chosen.size:
            axes.plot(
                chosen, np.minimum(cost, top)[chosen], ".", color=colour, markersize=5, label=stage
            )
    if not kept.all():
        axes.plot(
            np.flatnonzero(~kept),
            np.minimum(cost, top)[~kept],
            "x",
            color=PRINTED,
            markersize=3.5,
            alpha=0.6,
            label="not certified",
        )
    axes.plot(best, color=ESTIMATE, drawstyle="steps-post", label="best so far")
    _scaled(axes, best[np.isfinite(best)])
    finish(axes, "Candidates, on the runs tuned on", words, "candidate", legend=3)
    _compare(panels["held_out"], result)
    finish(panels["held_out"], "On held-out runs", words, "", legend=0)
    return figure


def around(result: Tuned, found: dict[str, Sweep]) -> Figure:
    """The metric over each tuned number, on held-out runs."""
    names = list(found)
    rows = [names[i : i + COLUMNS] for i in range(0, len(names), COLUMNS)]
    rows[-1] += [rows[-1][-1]] * (len(rows[0]) - len(rows[-1]))
    figure, panels = sheet(
        rows, "Around what was found, on held-out runs, the other numbers unchanged", height=3.0
    )
    words = f"{result.what.statistic} {WORDS.get(result.what.metric, result.what.metric)}"
    for parameter, value in zip(result.parameters, result.values, strict=True):
        axes, (x,), cost = (
            panels[parameter.name],
            found[parameter.name].axes.values(),
            found[parameter.name].cost,
        )
        axes.set_xscale("log" if parameter.log else "linear")
        finite = np.isfinite(cost) & (cost < 20 * cost.min())
        axes.plot(x[finite], cost[finite], ".-", color=ESTIMATE)
        if (lost := finite & (found[parameter.name].margin < result.what.margin)).any():
            axes.plot(x[lost], cost[lost], "x", color=PRINTED, label="not certified")
        axes.axvline(value, color=REFERENCE, label=f"tuned {value:.4g}")
        axes.axvline(
            parameter.start, color=ZONE, linestyle=(0, (4, 2)), label=f"start {parameter.start:.4g}"
        )
        axes.set_xlim(parameter.low, parameter.high)
        _scaled(axes, cost[finite])
        finish(axes, parameter.name, words, legend=2, x_label="")
    return figure


def _places(parameter: Parameter, value: float) -> Floats:
    """The number found, and a grid over its range."""
    return np.unique(np.append(parameter.value(np.linspace(0.0, 1.0, POINTS)), value))


def _compare(axes: Axes, result: Tuned) -> None:
    found = result.held_out[0]
    for place, (each, colour) in enumerate(((found.before, TRUTH), (found.after, ESTIMATE))):
        value, low, high = each.value
        reach = [[abs(end - value) if np.isfinite(end) else 0.0] for end in (low, high)]
        axes.errorbar([place], [value], yerr=reach, fmt="o", capsize=5, color=colour)
    axes.set_xticks([0, 1], ["before", "tuned"])
    axes.set_xlim(-0.6, 1.6)
    axes.set_ylim(bottom=0.0)
    axes.margins(y=0.2)


def _scaled(axes: Axes, shown: Floats) -> None:
    """A logarithmic axis where values span more than a decade."""
    if shown.size and shown.min() > 0 and shown.max() > 10 * shown.min():
        axes.set_yscale("log")
