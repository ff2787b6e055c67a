"""The files of a run and of a design: signals and gains, figures, a page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from undeadzone.report.figures import overview
from undeadzone.report.html import Origin, picture
from undeadzone.report.run_page import run_page
from undeadzone.report.style import write as write_figure
from undeadzone.support.files import write_text

if TYPE_CHECKING:
    from undeadzone.results.run import Run

TIP = "The tip against its path, its distance from it, and the torques."
PHASE = "Position and velocity of each joint, truth and estimate, over its dead zone."


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
    from undeadzone.report.arm_figures import phase, tip

    written = [
        write_figure(tip(result, rival), folder / "tip.svg"),
        write_figure(phase(result), folder / "phase.svg"),
    ]
    pictures = [
        picture(path.read_bytes(), words) for path, words in zip(written, (TIP, PHASE), strict=True)
    ]
    return written, [animated(result, rival), *pictures]
