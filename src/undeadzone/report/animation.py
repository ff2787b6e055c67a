"""An arm in motion: a drawing that plays inside a page, without anything fetched, or as a GIF or MP4 file."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.report.html import Html, html
from undeadzone.report.style import ESTIMATE, PRINTED, REFERENCE
from undeadzone.simulation.run import FRAMES, Run
from undeadzone.support.arrays import Floats
from undeadzone.support.files import replacing

if TYPE_CHECKING:
    from matplotlib.artist import Artist

MOVIES = (".gif", ".mp4")
SKIPPED = 2  # every how manieth frame a file shows
TILT = 0.35  # [rad] by which an arm in space is seen from above
SIDEWAYS = (
    0.5,
    0.9,
    -0.9,
    -0.5,
)  # [rad] from the direction of its path to what lies to the right in the drawing
TRAIL = 2.0  # [s] of the tip's way that a file shows


def animated(run: Run, rival: Run | None = None) -> Html:
    """A canvas that plays the arm, and a rival's in another colour, on the tip's path; spatial arms turn under the mouse."""
    script = files("undeadzone.report").joinpath("animation.js").read_text(encoding="utf-8")
    shown = _arms(run, rival)
    arms = [{"colour": colour, "frames": _rounded(poses)} for _, colour, poses in shown]
    spatial, path, grid = (
        _spatial(run),
        _path(run),
        _spacing(np.ptp(shown[-1][2][:, :, :2], axis=(0, 1)).max()),
    )
    data = {
        "rate": FRAMES,
        "arms": arms,
        "path": _rounded(path),
        "pathColour": REFERENCE,
        "spatial": spatial,
        "turn": _turn(run),
        "tilt": TILT if spatial else np.pi / 2,
        "grid": grid,
    }
    style = (
        "display:block;width:100%;max-width:880px;border:1px solid var(--line);border-radius:6px"
    )
    canvas = f'<canvas width="880" height="520" style="{style}" role="img" aria-label="The arm in motion"></canvas>'
    slider = '<input type="range" min="0" value="0" step="1" aria-label="time" style="width:60%;vertical-align:middle">'
    controls = (
        f'<p><button type="button">pause</button> {slider} <output class="note"></output></p>'
    )
    names = [(name, colour) for name, colour, _ in reversed(shown)] + [
        ("path of the tip", REFERENCE)
    ]
    keys = "&ensp;".join(
        f'<span style="color:{colour}">&#9632;</span> {html(name)}' for name, colour in names
    )
    legend = f'<p class="note">{keys}&ensp;grid {grid:g} m{"; drag to turn" * spatial}</p>'
    told = json.dumps(data).replace("<", "\\u003c")
    return Html(
        f'<div class="arm">{canvas}{controls}{legend}<script>{script}\nplay(document.currentScript.parentElement, {told});</script></div>'
    )


def require_movie(path: Path) -> None:
    """Raise FileError where an animation of that name cannot be written."""
    if path.suffix.lower() not in MOVIES:
        raise FileError(
            f"{path}: cannot write an animation with this name; it must end in {' or '.join(MOVIES)}"
        )
    if path.suffix.lower() == ".mp4":
        from matplotlib.animation import FFMpegWriter

        if not FFMpegWriter.isAvailable():
            raise FileError(
                f"{path}: cannot write MP4: ffmpeg is not installed; write a .gif instead"
            )


def movie(
    run: Run, rival: Run | None, path: Path, progress: Callable[[int], None] | None = None
) -> Path:
    """Write the motion as `.gif`, or as `.mp4` where ffmpeg is installed; progress: told of frames done. Raises FileError, InputError."""
    require_movie(path)
    if run.poses is None:
        raise InputError("animation: this plant is no arm; leave the option out")
    from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
    from matplotlib.figure import Figure

    spatial = _spatial(run)
    shown = slice(None, 3 if spatial else 2)
    figure = Figure(figsize=(6.4, 5.2), layout="constrained")
    axes: Any = figure.add_subplot(projection="3d" if spatial else None)
    axes.plot(
        *_path(run)[:, shown].T, color=REFERENCE, linewidth=4, alpha=0.4, label="path of the tip"
    )
    arms = _arms(run, rival)

    def drawn(**style: Any) -> list[Any]:
        return [
            axes.plot([], [], *[[]] * spatial, color=colour, **style)[0] for _, colour, _ in arms
        ]

    lines, trails = drawn(marker="o", markersize=4, linewidth=3), drawn(linewidth=1.2, alpha=0.7)
    for line, (name, _, _) in zip(lines, arms, strict=True):
        line.set_label(name)
    every = np.vstack([_path(run), *(poses.reshape(-1, 3) for _, _, poses in arms)])[:, shown]
    middle, reach = (
        (every.min(axis=0) + every.max(axis=0)) / 2,
        0.53 * float(np.ptp(every, axis=0).max()),
    )
    for name, centre in zip("xyz", middle, strict=False):
        getattr(axes, f"set_{name}lim")(centre - reach, centre + reach)
        getattr(axes, f"set_{name}label")(f"{name} [m]")
    axes.locator_params(nbins=5)
    axes.set_aspect("equal")
    if spatial:
        axes.view_init(elev=np.degrees(TILT), azim=np.degrees(-_turn(run)) - 90)
        axes.set_box_aspect((1, 1, 1), zoom=1.15)
    axes.grid(visible=True, alpha=0.4)
    axes.legend(loc="upper left", fontsize=8.5)

    def draw(frame: int) -> list[Artist]:
        for line, trail, (_, _, poses) in zip(lines, trails, arms, strict=True):
            now = min(frame, len(poses) - 1)
            for part, points in (
                (line, poses[now]),
                (trail, poses[max(0, now - round(TRAIL * FRAMES)) : now + 1, -1]),
            ):
                part.set_data(*points[:, :2].T)
                if spatial:
                    part.set_3d_properties(points[:, 2])
        axes.set_title(f"{run.info.title}, t = {frame / FRAMES:.2f} s", fontsize=9)
        return [*lines, *trails]

    draw(0)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # laid out once, for all frames
    form: Any = PillowWriter if path.suffix.lower() == ".gif" else FFMpegWriter
    with replacing(path) as temporary:
        motion = FuncAnimation(
            figure, draw, frames=range(0, max(len(poses) for _, _, poses in arms), SKIPPED)
        )
        motion.save(
            temporary,
            writer=form(fps=FRAMES / SKIPPED),
            dpi=80,
            progress_callback=lambda frame, total: progress(1) if progress is not None else None,
        )
    return path


def frames(run: Run) -> int:
    """How many frames a file shows of a run."""
    return 0 if run.poses is None else -(-len(run.poses) // SKIPPED)


def _arms(run: Run, rival: Run | None) -> list[tuple[str, str, Floats]]:
    """Name, colour and poses of each arm that is shown, up to where it diverged; the run's own last, above the other."""
    found = [] if rival is None else [(rival, PRINTED)]
    shown = []
    for one, colour in [*found, (run, ESTIMATE)]:
        assert one.poses is not None
        end = len(one.poses) if one.diverged_at is None else max(1, int(one.diverged_at * FRAMES))
        shown.append((one.name, colour, one.poses[:end]))
    return shown


def _path(run: Run) -> Floats:
    """Where the tip should be, in three coordinates, FRAMES per second."""
    assert run.tip_r is not None
    thin = run.tip_r[:: max(1, round(1 / FRAMES / run.info.step))]
    return np.pad(thin, ((0, 0), (0, 3 - thin.shape[1])))


def _spatial(run: Run) -> bool:
    return run.tip is not None and run.tip.shape[1] == 3


def _turn(run: Run) -> float:
    """By how much [rad] an arm in space is turned about z: its path lies beside its base, and its face is seen."""
    assert run.poses is not None
    if not _spatial(run):
        return 0.0
    path = _path(run)
    x, y, _ = path.mean(axis=0) - run.poses[0, 0]
    normal = np.linalg.svd(path - path.mean(axis=0), full_matrices=False)[2][-1]

    def seen(turn: float) -> float:
        eye = -np.cos(TILT) * np.sin(turn), -np.cos(TILT) * np.cos(turn), np.sin(TILT)
        return abs(float(normal @ eye))

    return max((sideways - float(np.arctan2(y, x)) for sideways in SIDEWAYS), key=seen)


def _spacing(size: float) -> float:
    """1, 2 or 5 times a power of ten: the distance [m] of some five to ten lines over a size [m]."""
    power = 10.0 ** np.floor(np.log10(max(size, 1e-3) / 5))
    return float(power * max(factor for factor in (1, 2, 5) if factor * power <= size / 5 + 1e-12))


def _rounded(values: Floats) -> list[object]:
    """Tenths of a millimetre: what a screen can show."""
    return list(np.round(values, 4).tolist())
