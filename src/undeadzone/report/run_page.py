"""The page of one run: its figures, its numbers, its gains, and what its readings can tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.report.gains_sections import trust
from undeadzone.report.html import Html, Origin, page, paragraph, picture, section, table, tag
from undeadzone.results.gap_words import SYMBOLS, gaps_with_deviations
from undeadzone.results.run import Run
from undeadzone.support.text import label, with_deviation, with_unit

_OVERVIEW: Final = (
    "Output, reading and estimate; errors; widths, in bands of two standard deviations, against "
    "the truth; command and widths of actuators that are estimated; reading over output, and gaps, "
    "of plays that are estimated; "
    "the Lyapunov function where there is one."
)
_VARIABLE: Final = "The observer has no constant gains; its options stand in the scenario."


def run_page(
    run: Run,
    figures: Sequence[bytes],
    rival: Run | None = None,
    first: Sequence[Any] = (),
    origin: Origin | None = None,
) -> str:
    """The page of one run.

    Args:
        run: what is shown.
        figures: of the run, as SVG; see `figures.overview`.
        rival: a run beside whose numbers those of the run stand.
        first: pieces of HTML above the figures.
        origin: what it takes to get the same run; None: what the run itself knows of it.
    """
    reasons: list[str] = []
    for name, verdict in zip(run.outputs, run.info.identifiable, strict=True):
        where = f"Output {name}: " if len(run.outputs) > 1 else ""
        reasons += [f"{where}{reason}." for reason in verdict["reasons"]]
    return page(
        run.info.title,
        _verdict(run),
        section("What happens", *first, *(picture(figure, _OVERVIEW) for figure in figures)),
        section("Numbers", _numbers_table(run, rival)),
        section(
            "Widths", _widths_table(run), *_actuators(run), *_gaps(run), *map(paragraph, reasons)
        ),
        section("Gains", *_gains(run)),
        origin=origin or Origin(scenario=run.info.scenario, seed=run.info.seed),
    )


def _verdict(run: Run) -> Html:
    """One line: diverged or not, the error, whether every width can be known."""
    unit = run.info.units.output
    if run.diverged_at is not None:
        return tag("p", tag("span", f"Diverged at {run.diverged_at:.4g} s.", "no"))
    known = tag("span", "every width can be known", "yes")
    if not run.fully_identifiable:
        known = tag("span", "not every width can be known", "no")
    rms = with_unit(f"rms of z − r {run.rms_tracking:.4g}", unit)
    parts = [tag("span", f"{rms} over the last {run.lasting:g} s"), known]
    if run.inexact:
        parts.append(tag("span", "the step is too large: these are no results", "no"))
    return Html("<p>" + "; ".join(part.text for part in parts) + ".</p>")


def _numbers_table(run: Run, rival: Run | None) -> Html:
    """The numbers of a run, beside those of a rival if there is one."""
    columns = [_numbers(run)]
    if rival is not None:
        columns.append(_numbers(rival))
    head = ("what", "value", "compared with")[: 1 + len(columns)]
    return table(head, [(name, *(column.get(name) for column in columns)) for name in columns[0]])


def _numbers(run: Run) -> dict[str, Any]:
    """The numbers of a run, in words."""
    unit, last = run.info.units.output, f"last {run.lasting:g} s"
    numbers: dict[str, Any] = {
        "observer": run.name,
        "time": f"{run.info.time}, step {run.info.step:g} s, {run.t[-1]:g} s",
        "diverged at [s]": run.diverged_at,
        label(f"rms of z − r, {last}", unit): run.rms_tracking,
        label(f"rms of z − z^, {last}", unit): run.rms_estimation,
    }
    if run.rms_behind_play is not None:
        numbers[label(f"rms of y / m − r, {last}", unit)] = run.rms_behind_play
    if run.rms_tip is not None:
        numbers[f"rms distance of the tip from its path, {last} [m]"] = run.rms_tip
    for name, parameter in run.parameters.items():
        estimate, std, true = (parameter[key] for key in ("estimate", "std", "true"))
        numbers[f"{name}, estimated"] = f"{with_deviation(estimate, std)} (true {true:g})"
    rise = "largest rise of V above an earlier value, relative to its largest"
    return numbers | {
        "share of silent samples": run.silent_fraction,
        "how strongly readings move z^": trust(run.info.listens),
        "certificate found for these gains": run.info.certified,
        rise: None if run.largest_rise_of_V is None else f"{run.largest_rise_of_V:.1g}",
        "integration error (against half the step)": _of_integration(run),
    }


def _of_integration(run: Run) -> str | None:
    """The error of the integration, which is known to its order of magnitude."""
    error = run.info.integration_error
    return None if error is None else f"{error:.1g}"


def _widths_table(run: Run) -> Html:
    """The estimated and the true widths of each output, and which of them readings can tell."""
    unit = run.info.units.output
    rows = []
    for i, (name, verdict) in enumerate(zip(run.outputs, run.info.identifiable, strict=True)):
        cells: list[Any] = []
        for column in (2 * i, 2 * i + 1):
            std = None if run.d_std is None else float(run.d_std[-1, column])
            value = float(run.d_hat[-1, column])
            cells += [value if std is None else with_deviation(value, std)]
            cells += [run.info.widths[column]]
        rows.append((name, *cells, *(_yes(verdict[each]) for each in DIRECTIONS)))
    estimates = (label("d_r^", unit), "true", label("d_l^", unit), "true")
    knowledge = ("d_r can be known", "d_l", "d_r + d_l", "d_r − d_l")
    return table(("output", *estimates, *knowledge), rows)


def _actuators(run: Run) -> list[Html]:
    """The estimated and the true widths of each actuator; nothing where none are estimated."""
    if run.b_hat is None or run.b_std is None:
        return []
    rows = []
    for j, (true_right, true_left) in enumerate(zip(*[iter(run.info.actuator)] * 2, strict=True)):
        last = zip(run.b_hat[-1, 2 * j : 2 * j + 2], run.b_std[-1, 2 * j : 2 * j + 2], strict=True)
        right, left = (with_deviation(float(value), float(std)) for value, std in last)
        rows.append((f"u[{j}]", right, true_right, left, true_left))
    unit = run.info.units.input
    return [table(("actuator", label("b_r^", unit), "true", label("b_l^", unit), "true"), rows)]


def _gaps(run: Run) -> list[Html]:
    """The estimated and the true gaps ahead of each dead zone; nothing where none are."""
    if run.c_hat is None or run.c_std is None or run.gap_std is None:
        return []
    rows = []
    for i, name in enumerate(run.outputs):
        true = run.info.gaps[2 * i : 2 * i + 2]
        c, std = run.c_hat[-1, 2 * i : 2 * i + 2], run.c_std[-1, 2 * i : 2 * i + 2]
        found = gaps_with_deviations(c, std, run.gap_std[-1, i])
        cells: list[Any] = []
        for estimate, truth in zip(found, (*true, sum(true)), strict=True):
            cells += [estimate, truth]
        rows.append((name, *cells))
    unit = run.info.units.output
    heads: list[str] = []
    for symbol in SYMBOLS:
        heads += [label(symbol, unit), "true"]
    return [table(("play ahead of the zone", *heads), rows)]


def _yes(known: bool) -> Html:
    """A yes or a no in its colour."""
    return tag("span", "yes" if known else "no", "yes" if known else "no")


def _gains(run: Run) -> list[Html]:
    """The constant gains of observer and controller."""
    gains = run.info.gains
    sampled = run.info.time == "sampled"
    parts = [] if "L" in gains else [paragraph(_VARIABLE)]
    if "L" in gains:
        head = ("L, of one step" if sampled else "L [1/s]", *map(_output, run.outputs))
        parts.append(table(head, _rows("x", gains["L"])))
    if "gamma" in gains:
        head = ("γ, of one step" if sampled else "γ [1/s]", *map(_output, run.outputs))
        parts.append(table(head, [("", *gains["gamma"])]))
    if "K" in gains:
        states = [f"x[{i}]" for i in range(len(gains["K"][0]))]
        parts.append(table(("K", *states), _rows("u", gains["K"])))
    return parts


def _output(name: str) -> str:
    """The head of an output's column."""
    return f"output {name}" if name.isdigit() else name


def _rows(letter: str, matrix: list[list[float]]) -> list[tuple[Any, ...]]:
    """The rows of a matrix, each named by a letter and its number."""
    return [(f"{letter}[{i}]", *row) for i, row in enumerate(matrix)]
