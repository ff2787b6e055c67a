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
from undeadzone.results.run import LAST
from undeadzone.results.sheet import format_number
from undeadzone.util.text import append_unit, label_with_unit
from undeadzone_studies.ensemble.result import MAIN, Ensemble
from undeadzone_studies.report.ensemble_figures import (
    describe_metric,
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
COLUMNS: Final = {"mean": "mean", "median": "median", "p95": "95 %", "p99": "99 %"}


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
    first, *others = _metric_tables(result, summary)
    parts = [html.build_section("Over time", first, *html.pick_pictures(pictures, "over_time"))]
    parts.append(
        html.build_section("Distributions", *others, *html.pick_pictures(pictures, "distributions"))
    )
    if result.varied:
        decisive = [
            *_sensitivity_table(summary),
            *html.pick_pictures(pictures, "tornado", "influence"),
        ]
        parts.append(html.build_section("What decides", *decisive))
    parts.append(html.build_section("The worst runs", *_worst_runs(result, summary)))
    parts.append(html.build_section("What was asked", *_scenario_section(result)))
    own = html.Origin(scenario=result.info.scenario, seed=result.info.seed)
    title = f"Ensemble: {result.info.title}"
    return html.build_page(title, _ensemble_verdict(result, summary), *parts, origin=origin or own)


def _ensemble_verdict(result: Ensemble, summary: Mapping[str, Any]) -> html.Html:
    """Return the shares of settled and diverged runs, and the 99 % quantile of the errors."""
    settled = summary["settled"]
    diverged = summary["diverged"]
    parts = [
        (f"{result.info.runs:,} runs", ""),
        (f"{_percent_with_interval(settled)} settle", _style_of_share(settled["value"])),
    ]
    if diverged["value"]:
        parts.append((f"{_percent_with_interval(diverged)} diverge", "no"))
    else:
        most = f"{100 * diverged['high']:.2g}"
        parts.append((f"none diverged (at most {most} % do)", "yes"))
    if summary["metrics"]:
        worst = summary["metrics"][MAIN]["p99"]["value"]
        name = describe_metric(MAIN, result.info.duration)
        limit = append_unit(f"{name} at most {worst:.4g}", result.unit(MAIN))
        parts.append((f"{limit} in 99 % of the runs that did not diverge", ""))
    return html.verdict_line(*parts)


def _style_of_share(share: float) -> str:
    """Return the style class of a share of runs that settle."""
    if share == 1:
        return "yes"
    return "mid" if share > 0.9 else "no"


def _percent_with_interval(share: Mapping[str, float]) -> str:
    """Return a share with its interval as text."""
    return f"{100 * share['value']:.4g} % [{100 * share['low']:.4g}, {100 * share['high']:.4g}]"


def _metric_tables(result: Ensemble, summary: Mapping[str, Any]) -> list[html.Html]:
    """Return the table of metrics and errors of the widths, with a note."""
    if not summary["metrics"]:
        return [html.build_paragraph("Every run diverged.", "no")]
    rows = []
    for name, values in summary["metrics"].items():
        if not name.startswith(("d_right[", "d_left[")):
            rows.append(_metric_row(name, values, result.unit(name), result.info.duration))
    beyond = 100 * summary["metrics"][MAIN]["max"]["beyond"]
    note = (
        "In parentheses: 95 % intervals. A dash is a value that these runs do not bound. "
        f"At most {beyond:.2g} % of all runs lie beyond the largest value found, "
        "with 95 % confidence. Runs that diverged are counted above and averaged nowhere."
    )
    first = [(row[0], *row[2:4]) for row in rows[: html.MOST]]  # median and 95 %
    every = html.build_table(("", *COLUMNS.values(), "largest"), rows)
    return [
        html.build_table(("", "median", "95 %"), first),
        every,
        html.build_paragraph(note, "note"),
    ]


def _metric_row(
    name: str, values: Mapping[str, Any], unit: str, duration: float
) -> tuple[Any, ...]:
    """Return the row of a metric for runs of some duration [s]."""
    cells = [
        _bounded_cell(name, values[column], _interval_cell(values[column])) for column in COLUMNS
    ]
    largest = _bounded_cell(name, values["max"], values["max"]["value"])
    return (label_with_unit(describe_metric(name, duration), unit), *cells, largest)


def _bounded_cell(name: str, value: Mapping[str, float | None], cell: Any) -> Any:
    """Return the cell of a value, or a word for a settling time without a bound."""
    if name == "settling_time" and value["value"] is None:
        return "never"
    return cell


def _interval_cell(value: Mapping[str, float | None]) -> html.Html:
    """Return a value with its interval, unbroken on a line of its own."""
    middle, low, high = (format_number(value[key], none="–") for key in ("value", "low", "high"))
    if middle == low == high:
        return html.Html(middle)
    return html.Html(f'{middle}<br><span class="note">({low}&nbsp;to&nbsp;{high})</span>')


def _sensitivity_table(summary: Mapping[str, Any]) -> list[html.Html]:
    """Return the table of the contributions of all entries, with a note."""
    sensitivities = summary["sensitivities"]
    if not sensitivities:
        return [html.build_paragraph("These runs do not decide: they are too few, or all alike.")]
    columns = {
        "spearman": "rank correlation",
        "partial": "the same, others held",
        "first_order": "share of the variance, alone",
    }
    note = (
        f"On the {describe_metric(MAIN)}, of the runs that did not diverge; "
        "95 % intervals in parentheses."
    )
    if any(each["total_order"] is not None for each in sensitivities.values()):
        columns["total_order"] = "with interactions"
    else:
        floor = next(iter(sensitivities.values()))["floor"]
        note += f" A share below {floor:.2g} may be chance."
    rows = []
    for name, each in sensitivities.items():
        rows.append((name, *(_interval_cell(each[key]) for key in columns)))
    return [
        html.build_table(("varied", *columns.values()), rows),
        html.build_paragraph(note, "note"),
    ]


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
    lasts = f"for the last {LAST:g} s" if info.duration > LAST else "at the end"
    lines = [
        ("observer", info.method),
        ("time", f"{info.time}, step {info.step:g} s, {info.duration:g} s"),
        ("runs", f"{info.runs:,}"),
        ("drawn by", f"{info.sampling}, seed {info.seed}"),
        ("settled", f"|z − r| stays within {100 * info.tolerance:g} % of the largest |r| {lasts}"),
    ]
    parts = [html.build_table(("what", "value"), lines)]
    if result.varied:
        ranges = []
        for name, column in result.varied.items():
            ends = float(np.min(column)), float(np.max(column))
            ranges.append((label_with_unit(name, result.unit(name)), *ends))
        parts.append(html.build_table(("varied", "least", "largest"), ranges))
    return parts
