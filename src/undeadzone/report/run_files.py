"""The files of a run and of a design: signals and gains, figures, a page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from undeadzone.report.figures import overview
from undeadzone.report.html import picture, run_page
from undeadzone.report.style import png
from undeadzone.report.style import write as write_figure
from undeadzone.support.files import write_text

if TYPE_CHECKING:
    from undeadzone.simulation.run import Run

TIP = "The tip against its path, its distance from it, and the torques."
PHASE = "Position and velocity of each joint, truth and estimate, over its dead zone."


def write_run(
    result: Run, folder: Path, figures: bool, rival: Run | None = None, tables: bool = True
) -> list[Path]:
    """Write the files of a run.

    Args:
        result: the run.
        folder: for the files; made if missing.
        figures: whether figure and page are wanted beside the signals.
        rival: a run to be shown beside it.
        tables: whether the signals are wanted as `.csv` too.

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
    figure = overview(result)
    written.append(write_figure(figure, folder / "figure.png"))
    first: list[Any] = []
    if result.poses is not None:
        files, first = _arm(result, folder, rival)
        written += files
    page = run_page(result, [figure], rival, first)
    written.append(write_text(page, folder / "report.html"))
    return written


def _arm(result: Run, folder: Path, rival: Run | None) -> tuple[list[Path], list[Any]]:
    """The files of an arm's own figures, and what the page begins with."""
    from undeadzone.report.animation import animated
    from undeadzone.report.arm_figures import phase, tip

    tip_figure, phase_figure = tip(result, rival), phase(result)
    written = [
        write_figure(tip_figure, folder / "tip.png"),
        write_figure(phase_figure, folder / "phase.png"),
    ]
    first = [
        animated(result, rival),
        picture(png(tip_figure), TIP),
        picture(png(phase_figure), PHASE),
    ]
    return written, first
