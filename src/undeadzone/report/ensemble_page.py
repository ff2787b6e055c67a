"""The page of an ensemble: how often it settles, how large the errors get, what decides, and which runs are the worst."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from undeadzone.ensemble.result import MAIN, Ensemble
from undeadzone.report.ensemble_figures import (
    WORDS,
    distributions,
    influence,
    over_time,
    tornado,
    words,
)
from undeadzone.report.html import Html, folded, page, paragraph, picture, section, table, tag
from undeadzone.report.style import label, write
from undeadzone.support.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTIONS: Final = {
    "distributions": "Above: how the runs are distributed. Below: the share of runs beyond each value, within its 95 % interval. Runs that diverged are left "
    "out; a run that did not settle stays beyond any settling time.",
    "over_time": "At each instant the median of the recorded runs and what 90 % and 98 % of them keep to. A band is not the course of any one run. Runs that "
    "diverged count as infinitely far off.",
    "tornado": "Left: what each entry adds, all others held, by ranks. Right: the share of the variance that vanishes if the entry is known; beyond the "
    "dashed line it is more than chance. Whiskers: 95 % intervals.",
    "influence": "Each dot is a run. A run whose error lies at the median is marked for comparison with the worst.",
}


def figures(result: Ensemble, summary: Mapping[str, Any]) -> dict[str, Figure]:
    """The figures that apply, by name."""
    drawn = {
        "distributions": distributions(result) if summary["metrics"] else None,
        "over_time": over_time(result),
        "tornado": tornado(summary["sensitivities"]),
        "influence": influence(result, summary["sensitivities"]),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}


def write_ensemble(result: Ensemble, summary: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the figures as PNG and report.html to a folder; summary: the result's. Raises FileError."""
    written = {
        name: write(figure, folder / f"{name}.png")
        for name, figure in figures(result, summary).items()
    }
    text = ensemble_page(
        result, summary, {name: path.read_bytes() for name, path in written.items()}
    )
    return [*written.values(), write_text(text, folder / "report.html")]


def ensemble_page(result: Ensemble, summary: Mapping[str, Any], images: Mapping[str, bytes]) -> str:
    """The page of an ensemble; images: PNGs by the names of `figures`."""
    shown = {
        name: picture(images[name], caption) if name in images else Html("")
        for name, caption in CAPTIONS.items()
    }
    parts = [section("Distributions", *_distributions(result, summary), shown["distributions"])]
    if "over_time" in images:
        parts.append(section("Over time", shown["over_time"]))
    if result.varied:
        parts.append(
            section("What decides", *_sensitivities(summary), shown["tornado"], shown["influence"])
        )
    parts.append(section("The worst runs", *_worst(result, summary)))
    parts.append(section("What was asked", *_asked(result)))
    return page(f"Ensemble: {result.info.title}", _verdict(result, summary), *parts)


def _verdict(result: Ensemble, summary: Mapping[str, Any]) -> Html:
    settled, diverged = summary["settled"], summary["diverged"]
    parts = [
        tag("span", f"{result.info.runs:,} runs"),
        tag(
            "span",
            f"{_percent(settled)} settle",
            "yes" if settled["value"] == 1 else "mid" if settled["value"] > 0.9 else "no",
        ),
        tag(
            "span",
            f"{_percent(diverged)} diverge"
            if diverged["value"]
            else f"none diverged (at most {100 * diverged['high']:.2g} % do)",
            _good(not diverged["value"]),
        ),
    ]
    if summary["metrics"]:
        worst = summary["metrics"][MAIN]["p99"]
        unit = "" if result.unit(MAIN) == "1" else f" {result.unit(MAIN)}"
        parts.append(
            tag(
                "span",
                f"{WORDS[MAIN]} at most {worst['value']:.4g}{unit} in 99 % of the runs that did not diverge",
            )
        )
    return Html("<p>" + "; ".join(part.text for part in parts) + ".</p>")


def _good(good: bool) -> str:
    return "yes" if good else "no"


def _percent(share: Mapping[str, float]) -> str:
    return f"{100 * share['value']:.4g} % ({100 * share['low']:.4g} to {100 * share['high']:.4g})"


def _distributions(result: Ensemble, summary: Mapping[str, Any]) -> list[Html]:
    if not summary["metrics"]:
        return [paragraph("Every run diverged.", "no")]
    columns = ("mean", "median", "p95", "p99")
    rows = [
        (
            label(words(name), result.unit(name)).replace(" ", "\u00a0"),
            *(_bounded(name, found[column], _interval(found[column])) for column in columns),
            _bounded(name, found["max"], found["max"]["value"]),
        )
        for name, found in summary["metrics"].items()
        if not name.startswith(("d_right[", "d_left["))
    ]
    beyond = summary["metrics"][MAIN]["max"]["beyond"]
    head = ("", "mean", "median", "95 %", "99 %", "largest")
    return [
        table(head, rows),
        paragraph(
            f"In parentheses: 95 % intervals; a dash is a value that these runs do not bound. At most {100 * beyond:.2g} % of all runs lie beyond the largest "
            "value found, with 95 % confidence. Runs that diverged are counted above and averaged nowhere.",
            "note",
        ),
    ]


def _bounded(name: str, found: Mapping[str, float | None], shown: Any) -> Any:
    """A settling time without a bound in words."""
    return "never" if name == "settling_time" and found["value"] is None else shown


def _interval(found: Mapping[str, float | None]) -> Html:
    """The interval stands on a line of its own, unbroken."""
    value, low, high = (
        "–" if found[key] is None else f"{found[key]:.4g}" for key in ("value", "low", "high")
    )
    return Html(
        value
        if value == low == high
        else f'{value}<br><span class="note">({low}&nbsp;to&nbsp;{high})</span>'
    )


def _sensitivities(summary: Mapping[str, Any]) -> list[Html]:
    found = summary["sensitivities"]
    if not found:
        return [paragraph("These runs do not tell: they are too few, or all alike.")]
    total = any(one["total_order"] is not None for one in found.values())
    keys = {
        "spearman": "rank correlation",
        "partial": "the same, others held",
        "first_order": "share of the variance, alone",
    }
    keys |= {"total_order": "with interactions"} if total else {}
    rows = [(name, *(_interval(one[key]) for key in keys)) for name, one in found.items()]
    chance = (
        "" if total else f" A share below {next(iter(found.values()))['floor']:.2g} may be chance."
    )
    note = f"On the {WORDS[MAIN]}, of the runs that did not diverge; 95 % intervals in parentheses.{chance}"
    return [table(("varied", *keys.values()), rows), paragraph(note, "note")]


def _worst(result: Ensemble, summary: Mapping[str, Any]) -> list[Html]:
    def row(found: Mapping[str, Any]) -> tuple[Any, ...]:
        outcome = tag("span", "diverged", "no") if found["diverged"] else found["metrics"][MAIN]
        return (found["run"], outcome, *found["varied"].values())

    typical = summary["typical"]
    head = (
        "run",
        label(WORDS[MAIN], result.unit(MAIN)),
        *(label(name, result.unit(name)) for name in result.varied),
    )
    parts = [table(head, map(row, summary["worst"]))]
    if typical is not None:
        parts += [
            paragraph("For comparison the run at the median:"),
            table(head, [row(result.row(typical))]),
        ]
    command = f"undeadzone run runs.npz --replay {summary['worst'][0]['run']}"
    return [
        *parts,
        paragraph(
            f"Each can be seen in full, bit for bit what it was, by its number: {command}", "note"
        ),
    ]


def _asked(result: Ensemble) -> list[Html]:
    info = result.info
    lines = [
        ("observer", info.method),
        ("time", f"{info.time}, step {info.step:g} s, {info.duration:g} s"),
        ("runs", f"{info.runs:,}"),
        ("drawn by", f"{info.sampling}, seed {info.seed}"),
        (
            "settled",
            f"|z − r| stays within {100 * info.tolerance:g} % of the largest |r| for the last 2 s",
        ),
        ("undeadzone", info.version),
    ]
    varied = [
        (label(name, result.unit(name)), float(np.min(column)), float(np.max(column)))
        for name, column in result.varied.items()
    ]
    parts = [table(("what", "value"), lines)] + (
        [table(("varied", "least", "largest"), varied)] if varied else []
    )
    return [*parts, folded("The scenario", tag("pre", info.scenario))]
