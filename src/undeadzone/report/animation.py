"""An arm in motion: a drawing that plays inside a page, or a GIF or MP4 file.

The page fetches nothing for it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.report import ink
from undeadzone.report.html import Html, html
from undeadzone.report.style import plain
from undeadzone.results.run import FRAMES, Run
from undeadzone.util.arrays import Floats
from undeadzone.util.files import replacing
from undeadzone.util.progress import silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

MOVIES = (".gif", ".mp4")
DPI = 80  # of a file
COLOURS = 32  # of a GIF
SKIPPED = 2  # every how manieth frame a file shows
TILT = 0.35  # [rad] by which an arm in space is seen from above
SIDEWAYS = (0.5, 0.9, -0.9, -0.5)  # [rad] from an arm's path to what lies right in the drawing
TRAIL = 2.0  # [s] of the tip's way that a file shows

_STYLE = "display:block;width:100%;max-width:880px;border:1px solid var(--line);border-radius:6px"
_CANVAS = (
    f'<canvas width="880" height="520" style="{_STYLE}" role="img" '
    'aria-label="The arm in motion"></canvas>'
)
_CONTROLS = (
    '<p><button type="button">pause</button> '
    '<input type="range" min="0" value="0" step="1" aria-label="time" '
    'style="width:60%;vertical-align:middle"> <output class="note"></output></p>'
)


class Arm(NamedTuple):
    """An arm that is shown.

    Attributes:
        name: of its run.
        colour: its colour.
        poses: where its joints are (frames x points x 3) [m].
        error: rms distance of its tip from the path over the last 2 s [m].
    """

    name: str
    colour: str
    poses: Floats
    error: float

    @property
    def label(self) -> str:
        """Return its name, and how far its tip is off at the end."""
        far = self.error >= 0.1
        size = f"{self.error:.2g} m" if far else f"{1e3 * self.error:.2g} mm"
        return f"{self.name}: tip {size} off at the end"


def animation_canvas(run: Run, rival: Run | None = None) -> Html:
    """Return a canvas that plays the arm on the tip's path, and a rival's in another colour.

    Arms in space turn under the mouse.
    """
    arms = _arms(run, rival)
    extent = float(np.ptp(arms[-1].poses[:, :, :2], axis=(0, 1)).max())  # [m] of the run's own arm
    grid = _spacing(extent)
    data = _script_data(run, arms, grid)
    script = files("undeadzone.report").joinpath("animation.js").read_text(encoding="utf-8")
    call = f"play(document.currentScript.parentElement, {data});"
    legend = _legend(arms, grid, _spatial(run))
    inner = f"{_CANVAS}{_CONTROLS}{legend}<script>{script}\n{call}</script>"
    return Html(f'<div class="arm">{inner}</div>')


def _script_data(run: Run, arms: list[Arm], grid: float) -> str:
    """What animation.js is given: JSON that cannot close the script; grid [m]: between lines."""
    spatial = _spatial(run)
    data = {
        "rate": FRAMES,
        "arms": [
            {"colour": arm.colour, "frames": _tenths_of_millimetre(arm.poses)} for arm in arms
        ],
        "path": _tenths_of_millimetre(_path(run)),
        "pathColour": ink.REFERENCE,
        "spatial": spatial,
        "turn": _turn(run),
        "tilt": TILT if spatial else np.pi / 2,
        "grid": grid,
    }
    return json.dumps(data).replace("<", "\\u003c")


def _legend(arms: list[Arm], grid: float, spatial: bool) -> str:
    """Return the names of arms and path in their colours, and the distance of the grid's lines
    [m].
    """
    names = [(arm.name, arm.colour) for arm in reversed(arms)]
    names.append(("path of the tip", ink.REFERENCE))
    keys = []
    for name, colour in names:
        keys.append(f'<span style="color:{colour}">&#9632;</span> {html(name)}')
    hint = "; drag to turn" if spatial else ""
    return f'<p class="note">{"&ensp;".join(keys)}&ensp;grid {grid:g} m{hint}</p>'


def require_movie(path: Path) -> None:
    """Raise FileError where an animation of that name cannot be written."""
    suffix = path.suffix.lower()
    if suffix not in MOVIES:
        raise FileError(
            f"{path}: cannot write an animation with this name; "
            f"it must end in {' or '.join(MOVIES)}"
        )
    if suffix == ".mp4":
        from matplotlib.animation import FFMpegWriter

        if not FFMpegWriter.isAvailable():
            raise FileError(
                f"{path}: cannot write MP4: ffmpeg is not installed; write a .gif instead"
            )


def movie(
    run: Run, rival: Run | None, path: Path, progress: Callable[[int], None] = silent
) -> Path:
    """Write the motion as `.gif`, or as `.mp4` where ffmpeg is installed.

    Args:
        run: of an arm
        rival: another run of it, shown beside it
        path: the file
        progress: called with 1 for each frame done

    Raises:
        FileError: the file cannot be written
        InputError: the plant is no arm
    """
    require_movie(path)
    if run.poses is None:
        raise InputError("animation: this plant is no arm; leave the option out")
    stage = _stage(run, _arms(run, rival))
    _draw(stage, 0)
    stage.figure.draw_without_rendering()
    stage.figure.set_layout_engine("none")  # laid out once, for all frames

    shown = range(0, max(len(arm.poses) for arm in stage.arms), SKIPPED)
    write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
    with replacing(path) as temporary:
        write(stage, shown, temporary, progress)
    return path


def _write_mp4(stage: Stage, shown: range, path: Path, progress: Callable[[int], None]) -> None:
    """An MP4 of some frames. Arguments as of `_write_gif`."""
    from matplotlib.animation import FFMpegWriter

    speed: Any = FRAMES / SKIPPED
    writer = FFMpegWriter(fps=speed)
    with writer.saving(stage.figure, path, DPI):
        for frame in shown:
            _draw(stage, frame)
            writer.grab_frame()
            progress(1)


def _write_gif(stage: Stage, shown: range, path: Path, progress: Callable[[int], None]) -> None:
    """A GIF of some frames, in few colours, of which each picture keeps what does not change.

    Its comment is the run's title.

    Args:
        stage: the figure, and what moves on it.
        shown: the frames.
        path: the file.
        progress: called with 1 for each frame done.
    """
    from PIL.Image import Dither

    palette = _picture(stage, shown[-1]).quantize(COLOURS)

    def pictures() -> Iterator[Image]:
        for frame in shown:
            picture = _picture(stage, frame)
            progress(1)
            yield picture.quantize(palette=palette, dither=Dither.NONE)

    first, *others = pictures()
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=others,
        duration=round(1000 * SKIPPED / FRAMES),
        loop=0,
        comment=stage.title.encode(),
    )


def _picture(stage: Stage, frame: int) -> Image:
    """What the figure shows at a frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL.Image import fromarray

    _draw(stage, frame)
    canvas: Any = FigureCanvasAgg(stage.figure)
    canvas.draw()
    return fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


class Stage(NamedTuple):
    """A figure on which arms move: a line and a trail of the tip for each of them, its title."""

    figure: Figure
    axes: Any
    arms: list[Arm]
    lines: list[Any]
    trails: list[Any]
    spatial: bool
    title: str


def _stage(run: Run, arms: list[Arm]) -> Stage:
    """Return the figure with the path and its limits, and lines that hold no points yet."""
    from matplotlib.figure import Figure

    spatial = _spatial(run)
    figure = Figure(figsize=(6.4, 6.0), dpi=DPI, layout="constrained")
    axes: Any = figure.add_subplot(projection="3d" if spatial else None)
    dimensions = 3 if spatial else 2
    path = _path(run)[:, :dimensions]
    axes.plot(*path.T, color=ink.REFERENCE, linewidth=4, alpha=0.4, label="path of the tip")
    empty: list[list[float]] = [[]] * dimensions
    lines, trails = [], []
    for arm in arms:
        lines += axes.plot(*empty, color=arm.colour, marker="o", markersize=4, linewidth=3)
    for arm in arms:
        trails += axes.plot(*empty, color=arm.colour, linewidth=1.2, alpha=0.7)
    for line, arm in zip(lines, arms, strict=True):
        line.set_label(plain(arm.label))
    points = [arm.poses.reshape(-1, 3)[:, :dimensions] for arm in arms]
    _limit(axes, np.vstack([path, *points]))
    if spatial:
        axes.view_init(elev=np.degrees(TILT), azim=np.degrees(-_turn(run)) - 90)
        axes.set_box_aspect((1, 1, 1), zoom=1.15)
    axes.grid(visible=True, alpha=0.4)
    figure.legend(loc="outside lower center", fontsize=9, ncols=2, frameon=False)
    return Stage(figure, axes, arms, lines, trails, spatial, plain(run.info.title))


def _limit(axes: Any, points: Floats) -> None:
    """Equally scaled axes that hold all points, with their labels."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, reach = (low + high) / 2, 0.53 * float(np.ptp(points, axis=0).max())
    for name, centre in zip("xyz", middle, strict=False):
        getattr(axes, f"set_{name}lim")(centre - reach, centre + reach)
        getattr(axes, f"set_{name}label")(f"{name} [m]")
    axes.locator_params(nbins=5)
    axes.set_aspect("equal")


def _draw(stage: Stage, frame: int) -> None:
    """Move every arm to where it is in a frame, with the last way of its tip."""
    for line, trail, arm in zip(stage.lines, stage.trails, stage.arms, strict=True):
        now = min(frame, len(arm.poses) - 1)
        before = max(0, now - round(TRAIL * FRAMES))
        _move(line, arm.poses[now], stage.spatial)
        _move(trail, arm.poses[before : now + 1, -1], stage.spatial)
    stage.axes.set_title(f"{stage.title}, t = {frame / FRAMES:.2f} s", fontsize=9)


def _move(line: Any, points: Floats, spatial: bool) -> None:
    """Give a line new points (N x 3)."""
    line.set_data(*points[:, :2].T)
    if spatial:
        line.set_3d_properties(points[:, 2])


def frames(run: Run) -> int:
    """How many frames a file shows of a run."""
    return 0 if run.poses is None else -(-len(run.poses) // SKIPPED)


def _arms(run: Run, rival: Run | None) -> list[Arm]:
    """Return the arms shown, each up to where it diverged; the run's own last, above the other."""
    own = _arm(run, ink.ESTIMATE)
    return [own] if rival is None else [_arm(rival, ink.PRINTED), own]


def _arm(run: Run, colour: str) -> Arm:
    """Return the arm of a run, up to where it diverged."""
    assert run.poses is not None
    end = len(run.poses)
    if run.divergence_time is not None:
        end = max(1, int(run.divergence_time * FRAMES))
    return Arm(run.name, colour, run.poses[:end], run.rms_tip or 0.0)


def _path(run: Run) -> Floats:
    """Where the tip should be (frames x 3) [m]."""
    assert run.tip_r is not None
    thin = run.tip_r[:: max(1, round(1 / FRAMES / run.info.step))]
    return np.pad(thin, ((0, 0), (0, 3 - thin.shape[1])))


def _spatial(run: Run) -> bool:
    """Return whether the arm moves in space, not in a plane."""
    return run.tip is not None and run.tip.shape[1] == 3


def _turn(run: Run) -> float:
    """By how much [rad] an arm in space is turned about z.

    Its path lies beside its base, and of the ways to have it so the one that shows most of the
    path's face is chosen.
    """
    assert run.poses is not None
    if not _spatial(run):
        return 0.0
    path = _path(run)
    middle = path.mean(axis=0)
    x, y, _ = middle - run.poses[0, 0]
    normal = np.linalg.svd(path - middle, full_matrices=False)[2][-1]  # of the plane of the path
    turns = [sideways - float(np.arctan2(y, x)) for sideways in SIDEWAYS]
    return max(turns, key=lambda turn: face_seen(normal, turn))


def face_seen(normal: Floats, turn: float) -> float:
    """How much of a plane's face is seen after a turn [rad] about z: 1 all, 0 nothing."""
    eye = -np.cos(TILT) * np.sin(turn), -np.cos(TILT) * np.cos(turn), np.sin(TILT)
    return abs(float(normal @ eye))


def _spacing(size: float) -> float:
    """Return the distance [m] of some five to ten lines over a size [m]: 1, 2 or 5 times 10^k."""
    size = max(size, 1e-3)
    power = 10.0 ** np.floor(np.log10(size / 5))
    fitting = [factor for factor in (1, 2, 5) if factor * power <= size / 5 + 1e-12]
    return float(power * max(fitting))


def _tenths_of_millimetre(values: Floats) -> list[object]:
    """Return tenths of a millimetre: what a screen can show."""
    return list(np.round(values, 4).tolist())
