"""Page and files of a run: figures, numbers, gains, identifiability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from undeadzone.interfaces import describe_rejected_assumptions, describe_unknowns
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.report import html
from undeadzone.report.run_figures import overview, plot_phase, plot_tip
from undeadzone.results.run import (
    Run,
    describe_last_noise,
    final_actuator_rows,
    final_error_rows,
    final_gap_rows,
    final_parameter_rows,
    final_width_rows,
)
from undeadzone.results.sheet import Row, rows_to_page
from undeadzone.results.signals import final_rejections
from undeadzone.util.text import append_unit

_VARIABLE: Final = "The observer has no constant gains. Its options stand in the scenario."
CAPTIONS: Final = {
    "tip": "The tip against its path, its distance from it, and the torques.",
    "phase": "Position and velocity of each joint, truth and estimate. A dead zone about a "
    "posture is grey.",
    "figure": "Output, reading and estimate. Errors. Widths with 95 % bands against the truth",
}
# Further contents of the figure, if a run has this signal.
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
    """Return the page of a run.

    Args:
        run: run to show.
        images: its figures as SVG, by name (see `CAPTIONS`).
        rival: a run beside whose numbers those of the run stand.
        origin: data to compute the same run (None: those stored in the run).
    """
    reasons: list[str] = []
    for name, verdict in zip(run.outputs, run.info.identifiable, strict=True):
        where = f"Output {name}: " if len(run.outputs) > 1 else ""
        reasons += [f"{where}{reason}." for reason in verdict["reasons"]]
    more = [words for name, words in FURTHER.items() if getattr(run, name) is not None]
    captions = CAPTIONS | {"figure": "; ".join([CAPTIONS["figure"], *more]) + "."}
    pictures = html.pick_pictures(html.encode_pictures(images, captions), *captions)
    first, rest = _numbers_tables(run, rival)
    return html.build_page(
        run.info.title,
        _verdict_on_run(run),
        html.build_section("What happens", first, *_animation_parts(run, rival, images), *pictures),
        html.build_section("Numbers", rest),
        html.build_section(
            "Widths",
            _widths_table(run),
            *further_tables(run.outputs, final_actuator_rows(run), final_gap_rows(run)),
            *map(html.build_paragraph, reasons),
        ),
        html.build_section("Gains", *_gain_tables(run)),
        origin=origin or html.Origin(scenario=run.info.scenario, seed=run.info.seed),
    )


def _animation_parts(run: Run, rival: Run | None, images: Mapping[str, bytes]) -> list[html.Html]:
    """Return an arm in motion, above its own figures."""
    if "tip" not in images:
        return []
    from undeadzone.report.animation import animation_canvas

    return [animation_canvas(run, rival)]


def _verdict_on_run(run: Run) -> html.Html:
    """Return a line: diverged or not, the error, whether every width is identifiable."""
    if run.divergence_time is not None:
        return html.build_tag(
            "p", html.build_tag("span", f"Diverged at {run.divergence_time:.4g} s.", "no")
        )
    rms = append_unit(f"rms of z − r {run.rms_tracking:.4g}", run.info.units.output)
    parts = [
        (f"{rms} over the last {run.lasting:g} s", ""),
        html.widths_verdict(run.fully_identifiable),
    ]
    if run.inexact:
        parts.append(("the step is too large, and the numbers are useless", "no"))
    return html.verdict_line(*parts)


def _numbers_tables(run: Run, rival: Run | None) -> tuple[html.Html, html.Html]:
    """Return the first numbers of a run and the rest, beside those of a rival if given."""
    columns = [_numbers_of_run(each) for each in (run, rival) if each is not None]
    head = ("what", "value", "compared with")[: 1 + len(columns)]
    rows = [(name, *(column.get(name) for column in columns)) for name in columns[0]]
    return html.build_table(head, rows[: html.MOST]), html.build_table(head, rows[html.MOST :])


def _numbers_of_run(run: Run) -> dict[str, Any]:
    """Return the numbers of a run by their descriptions, the most important first."""
    numbers: dict[str, Any] = {}
    for name, rows in zip(run.outputs, final_width_rows(run), strict=True):
        of = f", {_output_head(name)}" if len(run.outputs) > 1 else ""
        numbers |= {f"{row.title}{of}": row.value_in_words for row in rows}
    numbers |= {row.title: row.value_in_words for row in final_parameter_rows(run)}
    numbers |= rows_to_page(final_error_rows(run))
    refuted = final_rejections(run.signals.arrays).get("claims")
    if refuted:
        numbers["NOT as told"] = "; ".join(describe_rejected_assumptions(refuted, run.info.options))
    if louder := describe_last_noise(run):
        numbers["noise"] = louder
    if unknown := describe_unknowns(run.info.options):
        numbers["not told"] = unknown
    rise = "largest rise of V above an earlier value, relative to its largest"
    return numbers | {
        "share of silent samples": run.silent_fraction,
        "how strongly readings move z^": html.feedback_html(run.info.listens),
        "certificate found for these gains": run.info.certified,
        rise: _order_of_magnitude(run.largest_rise_of_V),
        "integration error (against half the step)": _order_of_magnitude(
            run.info.integration_error
        ),
        "diverged at [s]": run.divergence_time,
        "observer": run.observer_name,
        "time": f"{run.info.time}, step {run.info.step:g} s, {run.t[-1]:g} s",
    }


def _order_of_magnitude(error: float | None) -> str | None:
    """Return an error that is known to its order of magnitude."""
    return None if error is None else f"{error:.1g}"


def _widths_table(run: Run) -> html.Html:
    """Return the estimated and the true widths of each output, and their identifiability."""
    verdicts = ([verdict[each] for each in DIRECTIONS] for verdict in run.info.identifiable)
    known = [
        [html.build_tag("span", *html.choose_verdict(each)) for each in verdict]
        for verdict in verdicts
    ]
    heads = ("d_r can be known", "d_l", "width d_r + d_l", "centre (d_r − d_l)/2")
    return html.estimates_table("output", run.outputs, final_width_rows(run), heads, known)


def further_tables(
    outputs: Sequence[str], driven: Sequence[Sequence[Row]], ahead: Sequence[Sequence[Row]]
) -> list[html.Html]:
    """Return the estimated widths of actuators and gaps ahead of dead zones as tables."""
    inputs = [f"u[{j}]" for j in range(len(driven))]
    estimated = ("actuator", inputs, driven), ("play ahead of the zone", outputs, ahead)
    return [html.estimates_table(*each) for each in estimated if each[2]]


def _gain_tables(run: Run) -> list[html.Html]:
    """Return the constant gains of observer and controller."""
    gains = run.info.gains
    sampled = run.info.time == "sampled"
    parts = [] if "L" in gains else [html.build_paragraph(_VARIABLE)]
    if "L" in gains:
        head = ("L, of one step" if sampled else "L [1/s]", *map(_output_head, run.outputs))
        parts.append(html.build_table(head, _matrix_rows("x", gains["L"])))
    if "gamma" in gains:
        head = ("γ, of one step" if sampled else "γ [1/s]", *map(_output_head, run.outputs))
        parts.append(html.build_table(head, [("", *gains["gamma"])]))
    if "K" in gains:
        states = [f"x[{i}]" for i in range(len(gains["K"][0]))]
        parts.append(html.build_table(("K", *states), _matrix_rows("u", gains["K"])))
    return parts


def _output_head(name: str) -> str:
    """Return the head of an output's column."""
    return f"output {name}" if name.isdigit() else name


def _matrix_rows(letter: str, matrix: list[list[float]]) -> list[tuple[Any, ...]]:
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
    """Write the files of a run and return their paths.

    Args:
        result: the run.
        folder: for the files (created if missing).
        figures: whether figure and page are wanted beside the signals.
        rival: a run to be shown beside it.
        tables: whether the signals are wanted as `.csv` too.
        origin: data to compute the same run (None: those stored in the run).

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
        drawn |= {"tip": plot_tip(result, rival), "phase": plot_phase(result)}
    text = partial(run_page, result, rival=rival, origin=origin)
    return written + html.write_page(drawn, folder, text)
