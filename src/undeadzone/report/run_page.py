"""Page and files of a run: figures, numbers, gains, identifiability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from undeadzone.report import html
from undeadzone.report.run_figures import overview, plot_phase, plot_tip
from undeadzone.results.run import Run
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
    more = [words for name, words in FURTHER.items() if getattr(run, name) is not None]
    captions = CAPTIONS | {"figure": "; ".join([CAPTIONS["figure"], *more]) + "."}
    pictures = html.pick_pictures(html.encode_pictures(images, captions), *captions)
    runs = [each.blocks() for each in (run, rival) if each is not None]
    first, *rest = html.answer_tables(*runs)
    gains = gain_tables(run.info.gains, run.outputs, run.info.time == "sampled")
    return html.build_page(
        run.info.title,
        _verdict_on_run(run),
        html.build_section("What happens", first, *_animation_parts(run, rival, images), *pictures),
        html.build_section("Numbers", *rest, html.fold_numbers(run.summary() | {"seconds": None})),
        html.build_section("Gains", *gains),
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


def gain_tables(
    gains: Mapping[str, Any], outputs: Sequence[str], sampled: bool = False
) -> list[html.Html]:
    """Return the constant gains L (n x p) and gamma (p) of an observer, K (m x n) of a controller.

    Args:
        gains: by these names, as lists.
        outputs: their names (p).
        sampled: whether they are of one step.
    """
    unit = ", of one step" if sampled else " [1/s]"
    heads = [f"output {name}".removeprefix("output " * (not name.isdigit())) for name in outputs]
    parts = [] if "L" in gains else [html.build_paragraph(_VARIABLE)]
    if "L" in gains:
        parts.append(html.build_table((f"L{unit}", *heads), _matrix_rows("x", gains["L"])))
    if "gamma" in gains:
        parts.append(html.build_table((f"γ{unit}", *heads), [("", *gains["gamma"])]))
    if "K" in gains:
        states = [f"x[{i}]" for i in range(len(gains["K"][0]))]
        parts.append(html.build_table(("K", *states), _matrix_rows("u", gains["K"])))
    return parts


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
