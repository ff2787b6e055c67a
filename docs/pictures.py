"""Makes the pictures of README and of the pages: python docs/pictures.py [NAME ...].

Each file carries its title, by which a test knows a picture of yesterday.
"""

from __future__ import annotations

import runpy
import sys
import tempfile
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import undeadzone as uz
import undeadzone_arena
from undeadzone.report import animation, run_figures, style
from undeadzone.results.run import Run
from undeadzone.simulation.simulate import beside
from undeadzone_arena.contest.page import arena_figures as of_contest
from undeadzone_design.report import gain_figures
from undeadzone_identify import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOCS: Final = Path(__file__).parent
FIGURES: Final = DOCS / "figures"
EXAMPLES: Final = DOCS.parent / "examples"
STRAIGHT: Final = 0.999  # correlation of reading and input, above which a line hides a gap


def compared(example: str) -> tuple[Run, Run]:
    """The run of an example, and of the observer that stands beside it."""
    scenario = uz.read(EXAMPLES / f"{example}.toml")
    return beside(scenario, uz.simulate(scenario))


def gears() -> Figure:
    """The tip of an arm behind gears with gaps."""
    return run_figures.plot_tip(*compared("two_link_gears"))


def hidden() -> Figure:
    """The hidden output that `identify` finds in the log of a tutorial."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        found = runpy.run_path(str(DOCS / "tutorials/log_to_widths.py"))
    return figures.build_figures(found["answer"])["hidden"]


def trade() -> Figure:
    """Certified gains of the paper's example."""
    return gain_figures.plot_front(uz.design(uz.read(EXAMPLES / "paper_5sin.toml")))


def leaderboard() -> Figure:
    """All methods on a load cell."""
    found = undeadzone_arena.arena([uz.read(EXAMPLES / "load_cell_limited.toml")])
    return of_contest(found, [])["leaderboard"]


def logs() -> Figure:
    """Reading against input of each case of docs/cases.md, at the last sample of each input."""
    sys.path.insert(0, str(DOCS.parent))
    from benchmarks.end_to_end.cases import SEED
    from benchmarks.end_to_end.machines import CASES

    names = list(CASES)
    title = "Logs of six machines: the reading over the input, before the input changes"
    figure, panels = style.create_panels([names[:3], names[3:]], title, height=2.9)
    for name, case in CASES.items():
        columns, log = case.columns.split(","), case.record(np.random.default_rng(SEED))
        u, y = log[np.append(log[1:, 1] != log[:-1, 1], True), 1:3].T
        if np.corrcoef(u, y)[0, 1] > STRAIGHT:
            y, columns[2] = y - np.polyval(np.polyfit(u, y, 1), u), f"{columns[2]}, less a line"
        panels[name].plot(u, y, ".", markersize=2)
        style.finish_panel(panels[name], case.title.split(",")[0], columns[2], columns[1], legend=0)
    return figure


PICTURES: Final[dict[str, Callable[[], Figure]]] = {
    "two_link_gears": gears,
    "identify": hidden,
    "front": trade,
    "leaderboard": leaderboard,
    "cases": logs,
}


def draw(name: str) -> None:
    """Write a picture."""
    if name == "two_link":
        animation.write_movie(*compared(name), FIGURES / "two_link.gif")
    else:
        style.write_figure(PICTURES[name](), FIGURES / f"{name}.png")


if __name__ == "__main__":
    for each in sys.argv[1:] or [*PICTURES, "two_link"]:
        sys.stdout.write(f"{each}\n")
        draw(each)
