"""The page and the files of a log that an observer followed."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

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
)
from undeadzone.report.log_figures import log_overview
from undeadzone.report.run_page import gap_tables
from undeadzone.report.style import write as write_figure
from undeadzone.results.estimation import Estimation, gaps, widths
from undeadzone.support.files import write_text

_OVERVIEW = (
    "Reading and estimates over the estimated dead zone; missing readings are shaded. Below, the "
    "widths, and the innovations over their standard deviations with the statistic B of the test "
    "of consistency."
)
_TEST = (
    "The test: a normalised innovation has mean 0 and rms 1 if model, step, columns and claims "
    "are right. B is the mean square of their sums over two quarter periods of the plant, about 1. "
    "A reading beyond 4.5 standard deviations is refused by the test."
)
VERDICTS: Final = {
    True: ("yes", "yes"),
    False: ("no", "no"),
    None: ("that cannot be tested", "mid"),
}


def write_estimation(
    result: Estimation,
    folder: Path,
    figures: bool,
    tables: bool = True,
    origin: Origin | None = None,
) -> list[Path]:
    """Write the files of a log that was followed.

    Args:
        result: what the observer makes of it.
        folder: for the files; made if missing.
        figures: whether figure and page are wanted beside the signals.
        tables: whether the signals are wanted as `.csv` too.
        origin: what it takes to get the same again; None: nobody can.

    Returns:
        The paths of the files.

    Raises:
        FileError: a file cannot be written.
    """
    written = [result.save(folder / "estimate.npz")]
    if tables:
        written.append(result.save(folder / "estimate.csv"))
    if figures:
        drawn = write_figure(log_overview(result), folder / "figure.svg")
        page_text = estimation_page(result, drawn.read_bytes(), origin)
        written += [drawn, write_text(page_text, folder / "report.html")]
    return written


def estimation_page(result: Estimation, image: bytes, origin: Origin | None = None) -> str:
    """The page of a log that was followed: figure, numbers, verdict.

    Args:
        result: what the observer makes of the log.
        image: `log_overview` as SVG.
        origin: what it takes to get the same again; None: nobody can.
    """
    info = result.info
    words, style = VERDICTS[info.consistent]
    head = paragraph(tag("span", f"Is the record what the observer claims? {words}", style))
    reasons = [paragraph(f"{reason[:1].upper()}{reason[1:]}.") for reason in info.reasons]
    return page(
        info.title,
        head,
        *reasons,
        section("Along the log", picture(image, _OVERVIEW), paragraph(_TEST, "note")),
        section("Widths", _widths(result), *gap_tables(result.outputs, gaps(info))),
        section("The log", table(("what", "value"), list(_numbers(result).items()))),
        origin=origin,
    )


def _widths(result: Estimation) -> Html:
    """The final widths of each output, and how many readings lie on each side."""
    info = result.info
    sheets = [widths(info, i) for i in range(len(result.outputs))]
    counts = list(zip(info.right, info.left, info.silent, strict=True))
    heads = ("readings right", "left", "silent")
    return estimates("output", result.outputs, sheets, heads, counts)


def _numbers(result: Estimation) -> dict[str, Any]:
    """The numbers of a log, in words."""
    info = result.info
    return {
        "log": info.source,
        "columns": info.columns,
        "observer": f"{info.method}, step {info.step:g} s",
        "usual time between samples [s]": info.measured_step,
        "samples": info.samples,
        "missing": info.missing,
        "of these in gaps": info.gaps,
        "lines that could not be read": info.unreadable,
        "consistent": VERDICTS[info.consistent][0],
        "B at the end": info.B,
        "mean square of normalised innovations": info.square,
        "readings used": info.used,
        "readings taken for wrong": info.glitches,
        "silent far outside the zone": info.silent_outside,
        "smoothed with the whole log": result.z_smooth is not None,
    }
