"""The page of a tuning: the numbers found, what they are worth on other runs, and the search."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from undeadzone.report.html import (
    Html,
    Origin,
    folded,
    page,
    paragraph,
    section,
    source,
    table,
    verdict_line,
    yes_no,
)
from undeadzone.report.pictures import images_of, pick, pictures, write_figures
from undeadzone.report.tune_figures import around, history, slices
from undeadzone.statistics.intervals import Interval
from undeadzone.support import toml
from undeadzone.support.files import write_text
from undeadzone.support.text import counted
from undeadzone.tuning.result import HeldOut, Tuned

CAPTIONS: Final = {
    "history": "Left: what each candidate costs on the runs tuned on, and the best so far. Right: "
    "the scenario as it was and tuned on held-out runs, with 95 % intervals.",
    "around": "The metric on held-out runs as one number moves and the others stay. A flat curve "
    "is a number that hardly matters.",
}


def write_tuned(result: Tuned, folder: Path, origin: Origin | None = None) -> list[Path]:
    """Write history.svg, around.svg and report.html to a folder. Raises FileError.

    Args:
        result: what is shown.
        folder: where the files go; created if needed.
        origin: what it takes to get the same again; None: nobody can.

    Returns:
        The paths of the files.
    """
    drawn = {"history": history(result), "around": around(result, slices(result))}
    written = write_figures(drawn, folder)
    text = tuned_page(result, images_of(written), origin)
    return [*written.values(), write_text(text, folder / "report.html")]


def tuned_page(result: Tuned, images: dict[str, bytes], origin: Origin | None = None) -> str:
    """The page; images: SVGs by name; else see `write_tuned`."""
    shown = pictures(images, CAPTIONS)
    what = result.what
    asked = (
        f"Made small: {what.statistic} of {what.metric} over {what.runs} runs, with "
        f"{len(result.trials)} candidates of {what.budget}. Held-out runs are others than those "
        "tuned on: they tell what the numbers are worth. In parentheses: 95 % intervals."
    )
    return page(
        f"Tuned: {result.scenario.title}",
        _verdict(result),
        section("Numbers", _numbers(result), *map(paragraph, _at_edge(result))),
        section("What they are worth", paragraph(asked), _worth(result)),
        section("The search", *pick(shown, "history")),
        section("Around what was found", *pick(shown, "around")),
        section("The tuned scenario", folded("tuned.toml", source(toml.dumps(result.scenario)))),
        origin=origin,
    )


def _verdict(result: Tuned) -> Html:
    """One line: better or not, certified or not."""
    no_better = "no improvement that chance could not explain"
    parts = [yes_no(result.improved, "better on held-out runs", no_better)]
    if result.margin is not None:
        certified = f"certified, margin {result.margin:.4g}"
        parts.append(yes_no(result.certified, certified, "not certified"))
    return verdict_line(*parts)


def _numbers(result: Tuned) -> Html:
    """The numbers, from where they started and their ranges."""
    rows = []
    for parameter, value in zip(result.parameters, result.values, strict=True):
        bounds = f"{parameter.low:g} to {parameter.high:g}{', log' if parameter.log else ''}"
        rows.append((parameter.name, parameter.start, value, bounds))
    return table(("number", "before", "tuned", "range"), rows)


def _at_edge(result: Tuned) -> list[str]:
    """What lies at the end of its range."""
    words = "lies at the end of its range: a wider one may do better."
    return [f"{name} {words}" for name in result.at_edge]


def _worth(result: Tuned) -> Html:
    """Before and after, on the runs tuned on and on held-out ones of each scenario."""
    rows: list[tuple[Any, ...]] = [("runs tuned on", *map(float, result.cost), None, None)]
    for scenario, held_out in zip(result.scenarios, result.held_out, strict=True):
        rows.append(_held_out(scenario.title, held_out))
    rows.append(("change on held-out runs", None, _interval(result.change), None, None))
    return table(("", "before", "after", "diverged before", "after"), rows)


def _held_out(title: str, held_out: HeldOut) -> tuple[Any, ...]:
    """The row of a scenario's held-out runs."""
    before, after = held_out.before, held_out.after
    lost = [f"{100 * worth.diverged.value:.3g} %" for worth in (before, after)]
    name = f"{title}: {counted(held_out.runs, 'held-out run')}"
    return (name, _interval(before.value), _interval(after.value), *lost)


def _interval(interval: Interval) -> str:
    """A value with its interval."""
    value, low, high = interval
    return f"{value:.4g}" if low == high else f"{value:.4g} ({low:.4g} to {high:.4g})"
