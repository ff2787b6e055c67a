"""An arm in motion: a drawing that plays inside a page, without anything fetched, or as a GIF or MP4 file."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undeadzone.arrays import Floats
from undeadzone.errors import FileError, InputError
from undeadzone.files import replacing
from undeadzone.report.html import Html, html
from undeadzone.report.style import ESTIMATE, PRINTED, REFERENCE
from undeadzone.run import FRAMES, Run

if TYPE_CHECKING:
    from matplotlib.artist import Artist

MOVIES = (".gif", ".mp4")


def animated(run: Run, rival: Run | None = None) -> Html:
    """A canvas that plays the arm, and a rival's in another colour, on the tip's path; spatial arms turn under the mouse."""
    script = files("undeadzone.report").joinpath("animation.js").read_text(encoding="utf-8")
    arms = [{"name": name, "colour": colour, "frames": _rounded(poses)} for name, colour, poses in _arms(run, rival)]
    data = {"rate": FRAMES, "arms": arms, "path": _rounded(_path(run)), "pathColour": REFERENCE, "spatial": _spatial(run)}
    canvas = '<canvas class="stage" width="880" height="560" role="img" aria-label="The arm in motion"></canvas>'
    slider = '<input type="range" min="0" value="0" step="1" aria-label="time" style="width:60%">'
    controls = f'<p><button type="button">pause</button> {slider} <span class="note"></span></p>'
    names = ", ".join(f'<span style="color:{colour}">&#9632;</span> {html(name)}' for name, colour, _ in _arms(run, rival))
    legend = f'<p class="note">{names}, <span style="color:{REFERENCE}">&#9632;</span> path{" - drag to turn" * _spatial(run)}</p>'
    told = json.dumps(data).replace("<", "\\u003c")
    return Html(f'<div class="arm">{canvas}{controls}{legend}<script>{script}\nplay(document.currentScript.parentElement, {told});</script></div>')


def movie(run: Run, rival: Run | None, path: Path, progress: Callable[[int], None] | None = None) -> Path:
    """Write the motion as `.gif`, or as `.mp4` where ffmpeg is installed; progress: told of frames done. Raises FileError, InputError."""
    if path.suffix.lower() not in MOVIES:
        raise FileError(f"{path}: cannot write an animation with this name; it must end in {' or '.join(MOVIES)}")
    if run.poses is None:
        raise InputError("animation: this plant is no arm; leave the option out")
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
    from matplotlib.figure import Figure

    if path.suffix.lower() == ".mp4" and not FFMpegWriter.isAvailable():
        raise FileError(f"{path}: cannot write MP4: ffmpeg is not installed; write a .gif instead")
    spatial = _spatial(run)
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes = figure.add_subplot(projection="3d" if spatial else None)
    shown = slice(None, 3 if spatial else 2)
    axes.plot(*_path(run)[:, shown].T, color=REFERENCE, linewidth=3, alpha=0.5)
    arms = _arms(run, rival)
    lines: Any = [axes.plot([], [], *[[]] * spatial, color=colour, marker="o", linewidth=3, label=name)[0] for name, colour, _ in arms]
    every = np.vstack([poses.reshape(-1, 3) for _, _, poses in arms])[:, shown]
    middle, reach = (every.min(axis=0) + every.max(axis=0)) / 2, 0.55 * float(np.ptp(every, axis=0).max())
    for name, centre in zip("xyz", middle, strict=False):
        getattr(axes, f"set_{name}lim")(centre - reach, centre + reach)
        getattr(axes, f"set_{name}label")(f"{name} [m]")
    axes.set_aspect("equal")
    axes.legend(loc="upper right")

    def draw(frame: int) -> list[Artist]:
        for line, (_, _, poses) in zip(lines, arms, strict=True):
            line.set_data(*poses[frame, :, :2].T)
            if spatial:
                line.set_3d_properties(poses[frame, :, 2])
        axes.set_title(f"{run.info.title}, t = {frame / FRAMES:.2f} s", fontsize=9)
        return [*lines]

    motion = FuncAnimation(figure, draw, frames=min(len(poses) for _, _, poses in arms), interval=1000 / FRAMES)
    writer = PillowWriter(fps=FRAMES) if path.suffix.lower() == ".gif" else FFMpegWriter(fps=FRAMES)
    with replacing(path) as temporary:
        motion.save(temporary, writer=writer, dpi=80, progress_callback=lambda frame, total: progress(1) if progress is not None else None)
    return path


def _arms(run: Run, rival: Run | None) -> list[tuple[str, str, Floats]]:
    """Name, colour and poses of each arm that is shown, up to where it diverged."""
    found = [(PRINTED, f"compared: {rival.info.method}", rival)] if rival is not None else []
    shown = []
    for colour, name, one in [*found, (ESTIMATE, run.info.method, run)]:
        assert one.poses is not None
        end = len(one.poses) if one.diverged_at is None else max(1, int(one.diverged_at * FRAMES))
        shown.append((name, colour, one.poses[:end]))
    return shown


def _path(run: Run) -> Floats:
    """Where the tip should be, in three coordinates, FRAMES per second."""
    assert run.tip_r is not None
    thin = run.tip_r[:: max(1, round(1 / FRAMES / run.info.step))]
    return np.pad(thin, ((0, 0), (0, 3 - thin.shape[1])))


def _spatial(run: Run) -> bool:
    return run.tip is not None and run.tip.shape[1] == 3


def _rounded(values: Floats) -> list[object]:
    """Tenths of a millimetre: what a screen can show."""
    return list(np.round(values, 4).tolist())
