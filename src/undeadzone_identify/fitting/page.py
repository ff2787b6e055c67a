"""Figures and page of a fit: readings and prediction, scores, the least known directions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.report import html, ink
from undeadzone.report.style import create_panels, escape_formulas, finish_panel
from undeadzone.util import toml
from undeadzone_identify.fitting.checks import FLAGGED
from undeadzone_identify.fitting.result import HEAD, Fitted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS: Final = 20_000  # samples that a line shows at most
DIRECTIONS: Final = 2  # least known combinations that are shown
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
    rows = [(name, chance) for name, chance in result.checks.items()]
    bound = FLAGGED / len(rows)
    words = f"A test below {bound:.2g} contradicts the scenario. {result.agreement}"
    notes = [
        html.build_paragraph(f"Another answer fits as well: {each}.") for each in result.others
    ]
    return html.build_page(
        f"Fitted: {result.scenario.title}",
        html.verdict_line(html.choose_verdict(result.consistent, agrees, contradicted)),
        html.build_section(
            "Numbers",
            html.build_table(HEAD, result.describe_numbers()[1:]),
            *notes,
            *html.pick_pictures(pictures, "fit"),
        ),
        html.build_section(
            "Tests", html.build_table(("test", "p"), rows), html.build_paragraph(words)
        ),
        html.build_section(
            "The fitted scenario",
            html.fold_section("fitted.toml", html.source_html(toml.to_toml(result.scenario))),
        ),
        origin=origin,
    )


def plot_fit(result: Fitted) -> Figure:
    """Return the figure: readings with prediction, scores, least known directions."""
    rows = [["readings"], ["scores"], ["directions"]]
    figure, panels = create_panels(rows, f"{result.scenario.title}: fitted", height=2.6)
    plot_readings(panels["readings"], result)
    finish_panel(panels["readings"], "Readings", "y", legend=2, x_label="sample")
    axes = panels["scores"]
    every = _thin_out(result)
    axes.plot(every, result.signals.scores[every], ".", markersize=2, color=ink.READING)
    for side in (-1.96, 1.96):
        axes.axhline(side, color=ink.ZONE)
    finish_panel(axes, "Normal scores of the readings", "", legend=0, x_label="sample")
    _draw_directions(panels["directions"], result)
    return figure


def plot_readings(axes: Axes, result: Fitted) -> None:
    """Draw the readings and their prediction on the piece that they lie on."""
    every = _thin_out(result)
    axes.plot(every, result.signals.y[every], ".", markersize=2, color=ink.READING, label="y")
    seen = result.signals.prediction[every]
    axes.plot(every, seen, color=ink.ESTIMATE, label="prediction")


def _thin_out(result: Fitted) -> Any:
    """Return the samples that are drawn."""
    count = len(result.signals.t)
    return np.arange(0, count, max(1, count // POINTS))


def _draw_directions(axes: Axes, result: Fitted) -> None:
    """Draw the shares of the numbers in the least known directions as bars."""
    names = [escape_formulas(each.name.rpartition(".")[2]) for each in result.numbers]
    places = np.arange(len(names))
    colours = (ink.ESTIMATE, ink.REFERENCE)
    for k in range(min(DIRECTIONS, len(names))):
        shares = result.directions[:, k]
        axes.bar(places + 0.4 * k - 0.2, shares, 0.4, color=colours[k], label=f"direction {k + 1}")
    axes.set_xticks(places, names)
    finish_panel(axes, "Least known directions", "", legend=2, x_label="")
