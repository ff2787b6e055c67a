"""The page and the files of one run: figures, numbers, gains, what its readings can tell."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from undeadzone.analysis.identifiability.linear import DIRECTIONS
from undeadzone.report.html import (
    Html,
    Origin,
    estimates,
    page,
    paragraph,
    picture,
    section,
    table,
    tag,
    trust,
    verdict_line,
    widths_known,
    yes_no,
)
from undeadzone.report.run_figures import overview, phase, tip
from undeadzone.report.style import write as write_figure
from undeadzone.results.run import Run, actuators, errors, gaps, parameters, widths
from undeadzone.results.sheet import Row, on_page
from undeadzone.support.files import write_text
from undeadzone.support.text import with_unit

if TYPE_CHECKING:
    from undeadzone.results.run import Run

_OVERVIEW: Final = (
    "Output, reading and estimate; errors; widths, in bands of two standard deviations, against "
    "the truth; command and widths of actuators that are estimated; reading over output, and gaps, "
    "of plays that are estimated; "
    "the Lyapunov function where there is one."
)
_VARIABLE: Final = "The observer has no constant gains; its options stand in the scenario."
TIP = "The tip against its path, its distance from it, and the torques."
PHASE = "Position and velocity of each joint, truth and estimate, over its dead zone."


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
        figures: of the run, as SVG; see `run_figures.overview`.
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
            "Widths",
            _widths_table(run),
            *_actuators(run),
            *gap_tables(run.outputs, gaps(run, run.info.units.output, run.info.gaps)),
            *map(paragraph, reasons),
        ),
        section("Gains", *_gains(run)),
        origin=origin or Origin(scenario=run.info.scenario, seed=run.info.seed),
    )


def _verdict(run: Run) -> Html:
    """One line: diverged or not, the error, whether every width can be known."""
    if run.diverged_at is not None:
        return tag("p", tag("span", f"Diverged at {run.diverged_at:.4g} s.", "no"))
    rms = with_unit(f"rms of z − r {run.rms_tracking:.4g}", run.info.units.output)
    parts = [
        (f"{rms} over the last {run.lasting:g} s", ""),
        widths_known(run.fully_identifiable),
    ]
    if run.inexact:
        parts.append(("the step is too large: these are no results", "no"))
    return verdict_line(*parts)


def _numbers_table(run: Run, rival: Run | None) -> Html:
    """The numbers of a run, beside those of a rival if there is one."""
    columns = [_numbers(run)]
    if rival is not None:
        columns.append(_numbers(rival))
    head = ("what", "value", "compared with")[: 1 + len(columns)]
    return table(head, [(name, *(column.get(name) for column in columns)) for name in columns[0]])


def _numbers(run: Run) -> dict[str, Any]:
    """The numbers of a run, in words."""
    numbers: dict[str, Any] = {
        "observer": run.name,
        "time": f"{run.info.time}, step {run.info.step:g} s, {run.t[-1]:g} s",
        "diverged at [s]": run.diverged_at,
        **on_page(errors(run)),
    }
    for row in parameters(run):
        numbers[row.title] = row.words
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
    known = []
    for verdict in run.info.identifiable:
        known.append([tag("span", *yes_no(verdict[each])) for each in DIRECTIONS])
    sheets = [widths(run, i) for i in range(len(run.outputs))]
    heads = ("d_r can be known", "d_l", "d_r + d_l", "d_r − d_l")
    return estimates("output", run.outputs, sheets, heads, known)


def _actuators(run: Run) -> list[Html]:
    """The estimated and the true widths of each actuator; nothing where none are estimated."""
    found = actuators(run)
    return [estimates("actuator", (f"u[{j}]" for j in range(len(found))), found)] if found else []


def gap_tables(outputs: Sequence[str], found: Sequence[Sequence[Row]]) -> list[Html]:
    """The table of the gaps ahead of dead zones; nothing where none are estimated."""
    return [estimates("play ahead of the zone", outputs, found)] if found else []


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


def write_run(
    result: Run,
    folder: Path,
    figures: bool,
    rival: Run | None = None,
    tables: bool = True,
    origin: Origin | None = None,
) -> list[Path]:
    """Write the files of a run.

    Args:
        result: the run.
        folder: for the files; made if missing.
        figures: whether figure and page are wanted beside the signals.
        rival: a run to be shown beside it.
        tables: whether the signals are wanted as `.csv` too.
        origin: what it takes to get the same run; None: what the run itself knows of it.

    Returns:
        The paths of the files.

    Raises:
        FileError: a file cannot be written.
    """
    written = [result.save(folder / "run.npz")]
    if tables:
        written.append(result.save(folder / "run.csv"))
    if not figures:
        return written
    drawn = write_figure(overview(result), folder / "figure.svg")
    written.append(drawn)
    first: list[Any] = []
    if result.poses is not None:
        files, first = _arm(result, folder, rival)
        written += files
    page = run_page(result, [drawn.read_bytes()], rival, first, origin)
    written.append(write_text(page, folder / "report.html"))
    return written


def _arm(result: Run, folder: Path, rival: Run | None) -> tuple[list[Path], list[Any]]:
    """The files of an arm's own figures, and what the page begins with."""
    from undeadzone.report.animation import animated

    written = [
        write_figure(tip(result, rival), folder / "tip.svg"),
        write_figure(phase(result), folder / "phase.svg"),
    ]
    pictures = [
        picture(path.read_bytes(), words) for path, words in zip(written, (TIP, PHASE), strict=True)
    ]
    return written, [animated(result, rival), *pictures]
