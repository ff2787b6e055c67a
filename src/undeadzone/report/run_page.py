"""The page and the files of one run: figures, numbers, gains, what its readings can tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from undeadzone.interfaces import describe_rejected_assumptions
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.report import html
from undeadzone.report.run_figures import overview, phase, tip
from undeadzone.results.run import Run, actuators, errors, gaps, parameters, widths
from undeadzone.results.sheet import Row, on_page
from undeadzone.results.signals import claims_at_end
from undeadzone.util.text import with_unit

_VARIABLE: Final = "The observer has no constant gains; its options stand in the scenario."
CAPTIONS: Final = {
    "tip": "The tip against its path, its distance from it, and the torques.",
    "phase": "Position and velocity of each joint, truth and estimate; a dead zone about a "
    "posture is grey.",
    "figure": "Output, reading and estimate; errors; widths with 95 % bands against the truth",
}
# What else the figure shows, where a run has this signal.
FURTHER: Final = {
    "b_hat": "command and widths of the actuator",
    "c_hat": "reading over output, and gaps of the play",
    "V": "the Lyapunov function",
}


def run_page(
    run: Run,
    images: Mapping[str, bytes],
    rival: Run | None = None,
    origin: html.Origin | None = None,
) -> str:
    """Return the page of one run.

    Args:
        run: what is shown.
        images: its figures as SVG, by name; see `CAPTIONS`.
        rival: a run beside whose numbers those of the run stand.
        origin: what it takes to get the same run; None: what the run itself knows of it.
    """
    reasons: list[str] = []
    for name, verdict in zip(run.outputs, run.info.identifiable, strict=True):
        where = f"Output {name}: " if len(run.outputs) > 1 else ""
        reasons += [f"{where}{reason}." for reason in verdict["reasons"]]
    more = [words for name, words in FURTHER.items() if getattr(run, name) is not None]
    captions = CAPTIONS | {"figure": "; ".join([CAPTIONS["figure"], *more]) + "."}
    shown = html.pick(html.pictures(images, captions), *captions)
    first, rest = _numbers_tables(run, rival)
    return html.page(
        run.info.title,
        _verdict(run),
        html.section("What happens", first, *_animation(run, rival, images), *shown),
        html.section("Numbers", rest),
        html.section(
            "Widths",
            _widths_table(run),
            *further_tables(run.outputs, actuators(run), gaps(run)),
            *map(html.paragraph, reasons),
        ),
        html.section("Gains", *_gains(run)),
        origin=origin or html.Origin(scenario=run.info.scenario, seed=run.info.seed),
    )


def _animation(run: Run, rival: Run | None, images: Mapping[str, bytes]) -> list[html.Html]:
    """Return an arm in motion, above its own figures."""
    if "tip" not in images:
        return []
    from undeadzone.report.animation import animation_canvas

    return [animation_canvas(run, rival)]


def _verdict(run: Run) -> html.Html:
    """Return one line: diverged or not, the error, whether every width can be known."""
    if run.divergence_time is not None:
        return html.tag("p", html.tag("span", f"Diverged at {run.divergence_time:.4g} s.", "no"))
    rms = with_unit(f"rms of z − r {run.rms_tracking:.4g}", run.info.units.output)
    parts = [
        (f"{rms} over the last {run.lasting:g} s", ""),
        html.widths_known(run.fully_identifiable),
    ]
    if run.inexact:
        parts.append(("the step is too large: these are no results", "no"))
    return html.verdict_line(*parts)


def _numbers_tables(run: Run, rival: Run | None) -> tuple[html.Html, html.Html]:
    """Return the first numbers of a run and the rest, beside those of a rival if there is one."""
    columns = [_numbers(each) for each in (run, rival) if each is not None]
    head = ("what", "value", "compared with")[: 1 + len(columns)]
    rows = [(name, *(column.get(name) for column in columns)) for name in columns[0]]
    return html.table(head, rows[: html.MOST]), html.table(head, rows[html.MOST :])


def _numbers(run: Run) -> dict[str, Any]:
    """Return the numbers of a run, in words, those that a user asks for first."""
    numbers: dict[str, Any] = on_page(errors(run))
    for name, rows in zip(run.outputs, widths(run), strict=True):
        of = f", {_output(name)}" if len(run.outputs) > 1 else ""
        numbers |= {f"{row.title}{of}": row.words for row in rows}
    numbers |= {row.title: row.words for row in parameters(run)}
    refuted = claims_at_end(run.signals.arrays).get("claims")
    if refuted:
        numbers["NOT as told"] = "; ".join(describe_rejected_assumptions(refuted))
    rise = "largest rise of V above an earlier value, relative to its largest"
    return numbers | {
        "share of silent samples": run.silent_fraction,
        "how strongly readings move z^": html.trust(run.info.listens),
        "certificate found for these gains": run.info.certified,
        rise: _magnitude(run.largest_rise_of_V),
        "integration error (against half the step)": _magnitude(run.info.integration_error),
        "diverged at [s]": run.divergence_time,
        "observer": run.name,
        "time": f"{run.info.time}, step {run.info.step:g} s, {run.t[-1]:g} s",
    }


def _magnitude(error: float | None) -> str | None:
    """Return an error that is known to its order of magnitude."""
    return None if error is None else f"{error:.1g}"


def _widths_table(run: Run) -> html.Html:
    """Return the estimated and the true widths of each output, and which of them readings can
    tell.
    """
    said = ([verdict[each] for each in DIRECTIONS] for verdict in run.info.identifiable)
    known = [[html.tag("span", *html.yes_no(each)) for each in verdict] for verdict in said]
    heads = ("d_r can be known", "d_l", "width d_r + d_l", "centre (d_r − d_l)/2")
    return html.estimates("output", run.outputs, widths(run), heads, known)


def further_tables(
    outputs: Sequence[str], driven: Sequence[Sequence[Row]], ahead: Sequence[Sequence[Row]]
) -> list[html.Html]:
    """Return the widths of each actuator and the gaps ahead of dead zones; nothing of none."""
    inputs = [f"u[{j}]" for j in range(len(driven))]
    said = ("actuator", inputs, driven), ("play ahead of the zone", outputs, ahead)
    return [html.estimates(*each) for each in said if each[2]]


def _gains(run: Run) -> list[html.Html]:
    """Return the constant gains of observer and controller."""
    gains = run.info.gains
    sampled = run.info.time == "sampled"
    parts = [] if "L" in gains else [html.paragraph(_VARIABLE)]
    if "L" in gains:
        head = ("L, of one step" if sampled else "L [1/s]", *map(_output, run.outputs))
        parts.append(html.table(head, _rows("x", gains["L"])))
    if "gamma" in gains:
        head = ("γ, of one step" if sampled else "γ [1/s]", *map(_output, run.outputs))
        parts.append(html.table(head, [("", *gains["gamma"])]))
    if "K" in gains:
        states = [f"x[{i}]" for i in range(len(gains["K"][0]))]
        parts.append(html.table(("K", *states), _rows("u", gains["K"])))
    return parts


def _output(name: str) -> str:
    """Return the head of an output's column."""
    return f"output {name}" if name.isdigit() else name


def _rows(letter: str, matrix: list[list[float]]) -> list[tuple[Any, ...]]:
    """Return the rows of a matrix, each named by a letter and its number."""
    return [(f"{letter}[{i}]", *row) for i, row in enumerate(matrix)]


def write_run(
    result: Run,
    folder: Path,
    figures: bool,
    rival: Run | None = None,
    tables: bool = True,
    origin: html.Origin | None = None,
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
    drawn = {"figure": overview(result)}
    if result.poses is not None:
        drawn |= {"tip": tip(result, rival), "phase": phase(result)}
    text = partial(run_page, result, rival=rival, origin=origin)
    return written + html.write_page(drawn, folder, text)
