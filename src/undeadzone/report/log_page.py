"""The page and the files of a log that an observer followed."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from undeadzone.report.html import Origin, page, paragraph, picture, section, table, tag
from undeadzone.report.log_figures import log_overview
from undeadzone.report.style import write as write_figure
from undeadzone.results.estimation import Estimation
from undeadzone.results.gap_words import SYMBOLS, gaps_with_deviations
from undeadzone.support.files import write_text
from undeadzone.support.text import label, with_deviation

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
        section("Widths", table(_heads(info.units.output), _widths(result)), *_gaps(result)),
        section("The log", table(("what", "value"), list(_numbers(result).items()))),
        origin=origin,
    )


def _heads(unit: str) -> tuple[str, ...]:
    """The heads of the table of widths."""
    return ("output", label("d_r^", unit), label("d_l^", unit), "readings right", "left", "silent")


def _widths(result: Estimation) -> list[tuple[Any, ...]]:
    """The rows of the table of widths."""
    info = result.info
    unknown: list[float | None] = [None] * len(info.d_right)
    right_std, left_std = info.d_right_std or unknown, info.d_left_std or unknown
    rows = []
    for i, name in enumerate(result.outputs):
        right, left = _width(info.d_right[i], right_std[i]), _width(info.d_left[i], left_std[i])
        rows.append((name, right, left, info.right[i], info.left[i], info.silent[i]))
    return rows


def _gaps(result: Estimation) -> list[Any]:
    """The table of the gaps ahead of dead zones; nothing where none are estimated."""
    c, std, both = result.c_hat, result.c_std, result.gap_std
    if c is None or std is None or both is None:
        return []
    rows = []
    for i, name in enumerate(result.outputs):
        pair = slice(2 * i, 2 * i + 2)
        rows.append((name, *gaps_with_deviations(c[-1, pair], std[-1, pair], both[-1, i])))
    unit = result.info.units.output
    heads = [label(symbol, unit) for symbol in SYMBOLS]
    return [table(("play ahead of the zone", *heads), rows)]


def _width(value: float, std: float | None) -> float | str:
    """A width, with its deviation where known."""
    return value if std is None else with_deviation(value, std)


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
