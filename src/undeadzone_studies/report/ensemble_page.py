"""Page of an ensemble: shares of settled runs, sizes of errors, influential entries, worst runs.

The worst runs are listed with the numbers by which each can be run again.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.report import html
from undeadzone.util.text import label_with_unit
from undeadzone_studies.ensemble.result import MAIN, Ensemble
from undeadzone_studies.ensemble.words import describe_metric
from undeadzone_studies.report.ensemble_figures import (
    plot_bands,
    plot_distributions,
    plot_influence,
    plot_tornado,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS: Final = {
    "distributions": "Above: how the runs are distributed. Below: the share of runs beyond each "
    "value, within its 95 % interval. Runs that diverged are left out, and a run that did not "
    "settle stays beyond any settling time.",
    "over_time": "At each instant the median of the recorded runs and what 90 % and 98 % of them "
    "keep to. A band is not the course of any one run. Runs that diverged count as infinitely far "
    "off.",
    "tornado": "Left: what each entry adds, all others held, by ranks. Right: the share of the "
    "variance that vanishes if the entry is known: beyond the dashed line it is more than chance. "
    "Whiskers: 95 % intervals.",
    "influence": "Each dot is a run. A run whose error lies at the median is marked for comparison "
    "with the worst.",
}
LOST: Final = "Every run diverged."
UNDECIDED: Final = "These runs do not decide: they are too few, or all alike."


def draw_ensemble_figures(result: Ensemble, summary: Mapping[str, Any]) -> dict[str, Figure]:
    """Return the applicable figures, by name."""
    drawn = {
        "distributions": plot_distributions(result) if summary["metrics"] else None,
        "over_time": plot_bands(result),
        "tornado": plot_tornado(summary["sensitivities"]),
        "influence": plot_influence(result, summary["sensitivities"]),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def write_ensemble(
    result: Ensemble, summary: Mapping[str, Any], folder: Path, origin: html.Origin | None = None
) -> list[Path]:
    """Write the figures as SVG and report.html to a folder. Raises FileError.

    Args:
        result: result to show
        summary: the result's
        folder: folder of the files (created if needed)
        origin: data to compute the same again (None: those stored in the ensemble)

    Returns:
        The paths of the files.
    """

    text = partial(ensemble_page, result, summary, origin=origin)
    return html.write_page(draw_ensemble_figures(result, summary), folder, text)


def ensemble_page(
    result: Ensemble,
    summary: Mapping[str, Any],
    images: Mapping[str, bytes],
    origin: html.Origin | None = None,
) -> str:
    """Return the page.

    images: SVGs by the names of `draw_ensemble_figures`. The other arguments are those of
    `write_ensemble`.
    """
    pictures = html.encode_pictures(images, CAPTIONS)
    blocks: Any = result.blocks(dict(summary))
    _, shares, *tables = blocks
    shown = [html.build_table(head, rows) for head, *rows in tables]
    errors = shown[:1] if summary["metrics"] else [html.build_paragraph(LOST, "no")]
    parts = [html.build_section("Over time", *errors, *html.pick_pictures(pictures, "over_time"))]
    parts.append(
        html.build_section("Distributions", *html.pick_pictures(pictures, "distributions"))
    )
    if result.varied:
        pictured = html.pick_pictures(pictures, "tornado", "influence")
        decisive = shown[1:] or [html.build_paragraph(UNDECIDED)]
        parts.append(html.build_section("What decides", *decisive, *pictured))
    parts.append(html.build_section("The worst runs", *_worst_runs(result, summary)))
    parts.append(html.build_section("What was asked", *_scenario_section(result)))
    parts.append(html.build_section("Numbers", html.fold_numbers(summary)))
    verdict = html.verdict_line(
        (f"{result.info.runs:,} runs", ""),
        (f"settled {shares['settled']}", _style_of_share(summary["settled"]["value"])),
        (f"diverged {shares['diverged']}", "no" if summary["diverged"]["value"] else "yes"),
    )
    own = html.Origin(scenario=result.info.scenario, seed=result.info.seed)
    title = f"Ensemble: {result.info.title}"
    return html.build_page(title, verdict, *parts, origin=origin or own)


def _style_of_share(share: float) -> str:
    """Return the style class of a share of runs that settle."""
    if share == 1:
        return "yes"
    return "mid" if share > 0.9 else "no"


def _worst_runs(result: Ensemble, summary: Mapping[str, Any]) -> list[html.Html]:
    """Return the worst runs, the median run, and the command that shows a run."""
    units = [label_with_unit(name, result.unit(name)) for name in result.varied]
    head = (
        "run",
        label_with_unit(describe_metric(MAIN, result.info.duration), result.unit(MAIN)),
        *units,
    )
    parts = [html.build_table(head, map(_run_row, summary["worst"]))]
    typical = summary["typical"]
    if typical is not None:
        parts.append(html.build_paragraph("For comparison the run at the median:"))
        parts.append(html.build_table(head, [_run_row(result.row(typical))]))
    command = f"undeadzone run runs.npz --replay {summary['worst'][0]['run']}"
    note = f"Each can be seen in full, bit for bit, by its number: {command}"
    return [*parts, html.build_paragraph(note, "note")]


def _run_row(run: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the row of a run: its number, its error or that it diverged, its entries."""
    outcome = run["metrics"][MAIN]
    if run["diverged"]:
        outcome = html.build_tag("span", "diverged", "no")
    return (run["run"], outcome, *run["varied"].values())


def _scenario_section(result: Ensemble) -> list[html.Html]:
    """Return the observer, the runs, and the ranges of the varied entries."""
    info = result.info
    lines = [
        ("observer", info.method),
        ("time", f"{info.time}, step {info.step:g} s, {info.duration:g} s"),
        ("runs", f"{info.runs:,}"),
        ("drawn by", f"{info.sampling}, seed {info.seed}"),
    ]
    parts = [html.build_table(("what", "value"), lines)]
    if result.varied:
        ranges = []
        for name, column in result.varied.items():
            ends = float(np.min(column)), float(np.max(column))
            ranges.append((label_with_unit(name, result.unit(name)), *ends))
        parts.append(html.build_table(("varied", "least", "largest"), ranges))
    return parts
