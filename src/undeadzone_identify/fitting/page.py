"""Figures and page of a fit: readings and prediction, scores, the least known directions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.report import html, ink
from undeadzone.report.style import create_panels, escape_formulas, finish_panel
from undeadzone.util import toml
from undeadzone.util.text import HALF_95
from undeadzone_identify.fitting.result import HEAD, Fitted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS: Final = 20_000  # samples that a line shows at most
CAPTIONS: Final = {
    "fit": "Above: the readings, and their prediction from the readings before. Middle: their "
    "normal scores, independent and standard normal if the scenario is true. 95 % of them lie "
    "between the lines. "
    "Below: the two combinations of the numbers that the logs determine least, in deviations of "
    "each number.",
}


def write_fit(result: Fitted, folder: Path, origin: html.Origin | None) -> list[Path]:
    """Write fit.svg and report.html to a folder and return their paths. Raises FileError.

    Args:
        result: result to show.
        folder: folder of the files (created if needed).
        origin: data to compute the same again (None: unknown).
    """
    drawn = {"fit": plot_fit(result)}
    return html.write_page(drawn, folder, lambda images: build_fit_page(result, images, origin))


def build_fit_page(
    result: Fitted, images: dict[str, bytes], origin: html.Origin | None = None
) -> str:
    """Return the page (images: SVGs by name, else see `write_fit`)."""
    pictures = html.encode_pictures(images, CAPTIONS)
    contradicted = "the log contradicts the scenario"
    agrees = "the log does not contradict the scenario"
    words: Any
    rows: Any
    words, rows = result.blocks()
    return html.build_page(
        f"Fitted: {result.scenario.title}",
        html.verdict_line(html.choose_verdict(result.consistent, agrees, contradicted)),
        html.build_section(
            "Numbers", html.build_table(HEAD, rows[1:]), *html.pick_pictures(pictures, "fit")
        ),
        html.build_section(
            "Tests",
            html.build_table(("", ""), words.items()),
            html.build_table(("test", "p"), result.checks.items()),
        ),
        html.build_section("The fitted scenario", html.source_html(toml.to_toml(result.scenario))),
        origin=origin,
    )


def plot_fit(result: Fitted) -> Figure:
    """Return the figure: readings with prediction, scores, least known directions."""
    places = [["readings"], ["scores"], ["directions"]]
    figure, panels = create_panels(places, f"{result.scenario.title}: fitted", height=2.6)
    plot_readings(panels["readings"], result)
    finish_panel(panels["readings"], "Readings", "y", legend=2, x_label="sample")
    axes = panels["scores"]
    _plot_thinned(axes, result.signals.scores, ".", color=ink.READING)
    axes.axhline(-HALF_95, color=ink.ZONE)
    axes.axhline(HALF_95, color=ink.ZONE)
    finish_panel(axes, "Normal scores of the readings", "", legend=0, x_label="sample")
    _draw_directions(panels["directions"], result)
    return figure


def plot_readings(axes: Axes, result: Fitted) -> None:
    """Draw the readings and their prediction on the piece that they lie on."""
    _plot_thinned(axes, result.signals.y, ".", color=ink.READING, label="y")
    _plot_thinned(axes, result.signals.prediction, "-", color=ink.ESTIMATE, label="prediction")


def _plot_thinned(axes: Axes, values: Any, mark: str, **style: Any) -> None:
    """Draw values over samples, not more than `POINTS` of them."""
    every = slice(None, None, 1 + len(values) // POINTS)
    axes.plot(np.arange(len(values))[every], values[every], mark, markersize=2, **style)


def _draw_directions(axes: Axes, result: Fitted) -> None:
    """Draw the shares of the numbers in the least known directions as bars."""
    names = [escape_formulas(each.name.rpartition(".")[2]) for each in result.numbers]
    places = np.arange(len(names))
    for k, colour in enumerate((ink.ESTIMATE, ink.REFERENCE)[: len(names)]):
        shares = result.directions[:, k]
        axes.bar(places + 0.4 * k - 0.2, shares, 0.4, color=colour, label=f"direction {k + 1}")
    axes.set_xticks(places, names)
    finish_panel(axes, "Least known directions", "", legend=2, x_label="")
