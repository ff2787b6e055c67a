"""Makes the pictures of README and of the pages: python docs/pictures.py [NAME ...].

Each file carries its title, by which a test knows a picture of yesterday. The names `trades` and
`wrong` make the small pictures of docs/trades and docs/what_goes_wrong.md, and `records` the logs
that docs/trades offers.
"""

from __future__ import annotations

import re
import runpy
import sys
import tempfile
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL.Image import Dither, fromarray

import undeadzone as uz
import undeadzone_arena
from undeadzone.report import animation, ink, run_figures, style
from undeadzone.results.run import FRAMES, Run
from undeadzone.simulation.simulate import beside
from undeadzone_arena.contest.page import arena_figures as of_contest
from undeadzone_design.report import gain_figures
from undeadzone_identify import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undeadzone.util.arrays import Floats

DOCS: Final = Path(__file__).parent
FIGURES: Final = DOCS / "figures"
EXAMPLES: Final = DOCS.parent / "examples"
TRADES: Final = DOCS / "trades"
SKIPPED: Final = 2  # every how manieth frame a film shows
COLOURS: Final = 32  # of a film
COARSE: Final = 80  # resolution of a film [dots per inch]
FEW: Final = 400  # points of a curve in a small picture
LOGS: Final = ("load_cell", "valve", "hobby_servo", "two_encoders", "mount")
CODE: Final = re.compile(r"```python\n(.*?)```", re.S)
STRAIGHT: Final = 0.999  # correlation of reading and input, above which a line hides a gap


def compared(example: str) -> tuple[Run, Run]:
    """The run of an example, and of the observer that stands beside it."""
    scenario = uz.read(EXAMPLES / f"{example}.toml")
    return beside(scenario, uz.simulate(scenario))


def write_film(path: Path, *runs: Run) -> None:
    """Write the motion of an arm in a plane, with two observers, and the last 2 s of the tip's way.

    The comment of the GIF is the title of the first run.
    """
    figure, panels = style.create_panels([["arm"]], runs[0].info.title, 6.4, 6.0)
    axes = panels["arm"]
    arms = animation.build_arms(*runs)
    way: Any = runs[0].tip_r
    axes.plot(*way[:, :2].T, color=ink.REFERENCE, alpha=0.4, label="path of the tip")
    lines = [
        (
            axes.plot([], [], "o-", color=arm.colour, label=arm.name)[0],
            axes.plot([], [], color=arm.colour)[0],
        )
        for arm in arms
    ]
    style.finish_panel(axes, "The tip, and its way", "y [m]", "x [m]")
    reach = 1.1 * max(float(np.abs(arm.poses).max()) for arm in arms)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")

    figure.set_dpi(COARSE)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once, for all frames
    canvas: Any = FigureCanvasAgg(figure)

    def draw_frame(frame: int) -> Any:
        """The picture of each arm in its pose in a frame."""
        for (line, trail), arm in zip(lines, arms, strict=True):
            line.set_data(*arm.poses[frame, :, :2].T)
            trail.set_data(*arm.poses[max(0, frame - 2 * FRAMES) : frame + 1, -1, :2].T)

        canvas.draw()
        return fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")

    frames = range(0, len(arms[0].poses), SKIPPED)
    palette = draw_frame(frames[-1]).quantize(COLOURS)
    first, *others = (
        draw_frame(frame).quantize(palette=palette, dither=Dither.NONE) for frame in frames
    )
    first.save(
        path,
        save_all=True,
        append_images=others,
        duration=round(1000 * SKIPPED / FRAMES),
        loop=0,
        comment=runs[0].info.title.encode(),
    )


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


def sketch(
    title: str, labels: tuple[str, str], curves: dict[str, tuple[Floats, Floats, str, str]]
) -> Figure:
    """Return a small figure of one panel.

    Args:
        title: of the figure.
        labels: of the horizontal and of the vertical axis.
        curves: x, y, format and colour by name. Of many points some hundred are drawn.
    """
    figure, panels = style.create_panels([["all"]], title, width=6.4, height=2.3)
    for name, (x, y, form, colour) in curves.items():
        every = slice(None, None, -(-len(x) // FEW))
        panels["all"].plot(x[every], y[every], form, markersize=2.5, color=colour, label=name)
    style.finish_panel(panels["all"], "", labels[1], labels[0], legend=len(curves))
    return figure


def recorded(name: str) -> Floats:
    """Return the columns of a log of docs/trades."""
    return np.loadtxt(TRADES / f"{name}.csv", delimiter=",", skiprows=1).T


def run_code(page: Path) -> dict[str, Any]:
    """Return the names that the first Python block of a page defines."""
    code = CODE.search(page.read_text(encoding="utf-8"))
    assert code is not None, page
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(compile(code[1], page.name, "exec"), names)
    return names


def scale_and_sensor() -> Figure:
    """Last reading of each level of force."""
    _, force, reading = recorded("load_cell")
    last = np.append(force[1:] != force[:-1], True)
    ideal = np.array([-6.0, 6.0])
    return sketch(
        "Load cell: 0 between the edges, too small beyond",
        ("force [N]", "reading [N]"),
        {
            "no dead zone": (ideal, ideal, "-", ink.ZONE),
            "reading": (force[last], reading[last], ".", ink.READING),
        },
    )


def valve_and_loop() -> Figure:
    """Command and flow of a loop."""
    t, op, pv, sp = recorded("valve")[:, :1200]
    return sketch(
        "Flow loop: after each turn of OP the flow waits",
        ("t [min]", "[%]"),
        {
            "OP": (t / 60, op, "-", ink.OTHER),
            "PV": (t / 60, pv, "-", ink.ESTIMATE),
            "SP": (t / 60, sp, "-", ink.REFERENCE),
        },
    )


def joint_and_servo() -> Figure:
    """Difference of two encoders over the motor's."""
    _, motor, joint = recorded("two_encoders")
    return sketch(
        "Two encoders: the joint is half a gap behind, on either side",
        ("motor [deg]", "joint - motor [deg]"),
        {"difference": (motor, joint - motor, ".", ink.READING)},
    )


def axis_and_mount() -> Figure:
    """Star less a straight line over the pulses."""
    _, pulses, star = recorded("mount")
    rest = star - np.polyval(np.polyfit(pulses, star, 1), pulses)
    return sketch(
        "Telescope mount: the star waits after each reversal",
        ("pulses in all [ms]", "star less a line [arcsec]"),
        {"star": (pulses, rest, ".-", ink.READING)},
    )


def class_room() -> Figure:
    """Angle of a pendulum, its reading and its estimate."""
    run = uz.simulate(uz.read(EXAMPLES / "pendulum.toml"))
    early = run.t < 8.0
    t, z, y, z_hat = run.t[early], run.z[early, 0], run.y[early, 0], run.z_hat[early, 0]
    return sketch(
        "Pendulum: the reading rests at 0, the estimate does not",
        ("t [s]", "angle [rad]"),
        {
            "true": (t, z, "-", ink.TRUTH),
            "reading": (t, y, "-", ink.READING),
            "estimate": (t, z_hat, "--", ink.ESTIMATE),
        },
    )


def paper() -> Figure:
    """Convergence of the widths in the paper's example."""
    run = uz.simulate(uz.read(EXAMPLES / "paper_5sin.toml"))
    early = run.t < 10.0
    return sketch(
        "The paper's example, repaired: both widths converge to 1",
        ("t [s]", "width"),
        {
            "true": (run.t[early], np.ones(early.sum()), "-", ink.TRUTH),
            "right": (run.t[early], run.d_hat[early, 0], "-", ink.PRINTED),
            "left": (run.t[early], run.d_hat[early, 1], "--", ink.OTHER),
        },
    )


def filter_author() -> Figure:
    """Estimate of the filter that the page shows."""
    names = run_code(TRADES / "filter_author.md")
    t, z, y, estimate = (np.asarray(names[key]) for key in ("t", "z", "y", "estimate"))
    return sketch(
        "Kalman filter with the dead-zone update",
        ("t [s]", "z"),
        {
            "true": (t, z, "-", ink.TRUTH),
            "reading": (t, y, "-", ink.READING),
            "estimate": (t, estimate, "--", ink.ESTIMATE),
        },
    )


def spoilt() -> dict[str, Figure]:
    """Return a picture of each bad record of docs/what_goes_wrong.md: reading over force."""
    records = run_code(DOCS / "what_goes_wrong.md")["records"]
    u, y = records.pop("good log")
    last = np.append(u[1:] != u[:-1], True)
    figures = {}
    for name, (force, reading) in records.items():
        figures[name.replace(" ", "_")] = sketch(
            name.capitalize(),
            ("force at the end of each level", "reading"),
            {
                "good log": (u[last], y[last], ".", ink.ZONE),
                "this log": (force[last], reading[last], ".", ink.PRINTED),
            },
        )
    return figures


def write_records() -> None:
    """Write the logs that docs/trades offers: those of docs/cases.md, with six digits."""
    sys.path.insert(0, str(DOCS.parent))
    from benchmarks.end_to_end.cases import SEED
    from benchmarks.end_to_end.machines import CASES

    for name in LOGS:
        log = CASES[name].record(np.random.default_rng(SEED))
        path, head = TRADES / f"{name}.csv", CASES[name].columns
        np.savetxt(path, log, fmt="%.6g", delimiter=",", header=head, comments="")


READERS: Final[dict[str, Callable[[], Figure]]] = {
    "scale_and_sensor": scale_and_sensor,
    "valve_and_loop": valve_and_loop,
    "joint_and_servo": joint_and_servo,
    "axis_and_mount": axis_and_mount,
    "class_room": class_room,
    "paper": paper,
    "filter_author": filter_author,
}
PICTURES: Final[dict[str, Callable[[], Figure]]] = {
    "two_link_gears": gears,
    "identify": hidden,
    "front": trade,
    "leaderboard": leaderboard,
    "cases": logs,
}


def draw(name: str) -> None:
    """Write a picture, or the small ones of a folder."""
    if name == "two_link":
        write_film(FIGURES / "two_link.gif", *compared(name))
    elif name == "records":
        write_records()
    elif name in ("trades", "wrong"):
        drawn = spoilt() if name == "wrong" else {key: make() for key, make in READERS.items()}
        for key, figure in drawn.items():
            style.write_figure(figure, FIGURES / name / f"{key}.svg")
    else:
        style.write_figure(PICTURES[name](), FIGURES / f"{name}.png")


if __name__ == "__main__":
    for each in sys.argv[1:] or ["records", *PICTURES, "two_link", "trades", "wrong"]:
        sys.stdout.write(f"{each}\n")
        draw(each)
