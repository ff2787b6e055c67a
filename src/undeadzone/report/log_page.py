"""The page and the files of a log that an observer followed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from undeadzone.report.html import page, paragraph, picture, section, table
from undeadzone.report.log_figures import log_overview
from undeadzone.report.style import png
from undeadzone.report.style import write as write_figure
from undeadzone.simulation.estimation import Estimation
from undeadzone.support.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


def write_estimation(
    result: Estimation, folder: Path, figures: bool, tables: bool = True
) -> list[Path]:
    """Write the files of a log that was followed.

    Args:
        result: what the observer makes of it.
        folder: for the files; made if missing.
        figures: whether figure and page are wanted beside the signals.
        tables: whether the signals are wanted as `.csv` too.

    Returns:
        The paths of the files.

    Raises:
        FileError: a file cannot be written.
    """
    written = [result.save(folder / "estimate.npz")]
    if tables:
        written.append(result.save(folder / "estimate.csv"))
    if figures:
        figure = log_overview(result)
        written.append(write_figure(figure, folder / "figure.png"))
        written.append(write_text(estimation_page(result, figure), folder / "report.html"))
    return written


def estimation_page(result: Estimation, figure: Figure) -> str:
    """The page of a log that was followed: figure, numbers, verdict."""
    info = result.info
    reasons = [paragraph(reason) for reason in info.reasons]
    return page(
        info.title,
        picture(png(figure), _OVERVIEW),
        section("Widths", table(_heads(info.units.output), _widths(result))),
        section("Is the record what the observer claims?", *reasons, paragraph(_TEST, "note")),
        section("The log", table(("what", "value"), list(_numbers(result).items()))),
    )


def _heads(unit: str) -> tuple[str, ...]:
    """The heads of the table of widths."""
    widths = (f"d_r^ [{unit}]", "std", f"d_l^ [{unit}]", "std")
    return ("output", *widths, "readings right", "left", "silent")


def _widths(result: Estimation) -> list[tuple[Any, ...]]:
    """The rows of the table of widths."""
    info = result.info
    rows = []
    for i, name in enumerate(result.outputs):
        right_std = None if info.d_right_std is None else info.d_right_std[i]
        left_std = None if info.d_left_std is None else info.d_left_std[i]
        counts = (info.right[i], info.left[i], info.silent[i])
        rows.append((name, info.d_right[i], right_std, info.d_left[i], left_std, *counts))
    return rows


def _numbers(result: Estimation) -> dict[str, Any]:
    """The numbers of a log, in words."""
    info = result.info
    verdicts = {True: "yes", False: "NO", None: "cannot be tested"}
    return {
        "log": info.source,
        "columns": info.columns,
        "observer": f"{info.method}, step {info.step:g} s",
        "usual time between samples [s]": info.measured_step,
        "samples": info.samples,
        "missing": info.missing,
        "of these in gaps": info.gaps,
        "lines that could not be read": info.unreadable,
        "consistent": verdicts[info.consistent],
        "B at the end": info.B,
        "mean square of normalised innovations": info.square,
        "readings used": info.used,
        "readings taken for wrong": info.glitches,
        "silent far outside the zone": info.silent_outside,
        "smoothed with the whole log": result.z_smooth is not None,
    }
