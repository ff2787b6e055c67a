"""Animation of an arm: a drawing that plays inside a page, or a GIF or MP4 file.

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
from undeadzone.report.html import Html, format_html
from undeadzone.report.style import escape_formulas
from undeadzone.results.run import FRAMES, Run
from undeadzone.util.arrays import Floats
from undeadzone.util.files import replace_file
from undeadzone.util.progress import ignore_progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

MOVIES = (".gif", ".mp4")
DPI = 80  # of a file
COLOURS = 32  # of a GIF
SKIPPED = 2  # every how manieth frame a file shows
TILT = 0.35  # [rad] by which an arm in space is seen from above
SIDEWAYS = (0.5, 0.9, -0.9, -0.5)  # directions of an arm's path [rad], 0: right in the drawing
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
    """Arm in an animation.

    Attributes:
        name: of its run.
        colour: its colour.
        poses: positions of its joints (frames x points x 3) [m].
        error: rms distance of its tip from the path over the last 2 s [m].
    """

    name: str
    colour: str
    poses: Floats
    error: float

    @property
    def label(self) -> str:
        """Return the arm's name, and the distance of its tip from the path at the end."""
        far = self.error >= 0.1
        size = f"{self.error:.2g} m" if far else f"{1e3 * self.error:.2g} mm"
        return f"{self.name}: tip {size} off at the end"


def animation_canvas(run: Run, rival: Run | None = None) -> Html:
    """Return a canvas that plays the arm on the tip's path, and a rival's in a second colour.

    Arms in space turn under the mouse.
    """
    arms = _build_arms(run, rival)
    extent = float(np.ptp(arms[-1].poses[:, :, :2], axis=(0, 1)).max())  # [m] of the run's own arm
    grid = _grid_spacing(extent)
    data = _script_data(run, arms, grid)
    script = files("undeadzone.report").joinpath("animation.js").read_text(encoding="utf-8")
    call = f"play(document.currentScript.parentElement, {data});"
    legend = _animation_legend(arms, grid, _is_spatial(run))
    inner = f"{_CANVAS}{_CONTROLS}{legend}<script>{script}\n{call}</script>"
    return Html(f'<div class="arm">{inner}</div>')


def _script_data(run: Run, arms: list[Arm], grid: float) -> str:
    """Return the data for animation.js:

    JSON that cannot close the script. grid: distance of the lines [m].
    """
    spatial = _is_spatial(run)
    data = {
        "rate": FRAMES,
        "arms": [{"colour": arm.colour, "frames": _round_for_screen(arm.poses)} for arm in arms],
        "path": _round_for_screen(_tip_path(run)),
        "pathColour": ink.REFERENCE,
        "spatial": spatial,
        "turn": _view_turn(run),
        "tilt": TILT if spatial else np.pi / 2,
        "grid": grid,
    }
    return json.dumps(data).replace("<", "\\u003c")


def _animation_legend(arms: list[Arm], grid: float, spatial: bool) -> str:
    """Return the names of arms and path in their colours, and the distance of the grid's lines
    [m].
    """
    names = [(arm.name, arm.colour) for arm in reversed(arms)]
    names.append(("path of the tip", ink.REFERENCE))
    keys = []
    for name, colour in names:
        keys.append(f'<span style="color:{colour}">&#9632;</span> {format_html(name)}')
    hint = ", drag to turn" if spatial else ""
    return f'<p class="note">{"&ensp;".join(keys)}&ensp;grid {grid:g} m{hint}</p>'


def require_movie(path: Path) -> None:
    """Raise FileError if an animation with this name cannot be written."""
    suffix = path.suffix.lower()
    if suffix not in MOVIES:
        raise FileError(
            f"{path}: cannot write an animation with this name. "
            f"It must end in {' or '.join(MOVIES)}"
        )
    if suffix == ".mp4":
        from matplotlib.animation import FFMpegWriter

        if not FFMpegWriter.isAvailable():
            raise FileError(
                f"{path}: cannot write MP4: ffmpeg is not installed. Write a .gif instead"
            )


def write_movie(
    run: Run, rival: Run | None, path: Path, progress: Callable[[int], None] = ignore_progress
) -> Path:
    """Write the motion as `.gif`, or as `.mp4` if ffmpeg is installed. Return the path.

    Args:
        run: of an arm
        rival: another run of it, displayed beside it
        path: the file
        progress: called with 1 for each frame done

    Raises:
        FileError: the file cannot be written
        InputError: the plant is not an arm
    """
    require_movie(path)
    if run.poses is None:
        raise InputError("animation: this plant is not an arm. Leave the option out")
    stage = _build_stage(run, _build_arms(run, rival))
    _draw_frame(stage, 0)
    stage.figure.draw_without_rendering()
    stage.figure.set_layout_engine("none")  # laid out once, for all frames

    frames = range(0, max(len(arm.poses) for arm in stage.arms), SKIPPED)
    write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
    with replace_file(path) as temporary:
        write(stage, frames, temporary, progress)
    return path


def _write_mp4(stage: Stage, frames: range, path: Path, progress: Callable[[int], None]) -> None:
    """Write an MP4 of some frames. Arguments as for `_write_gif`."""
    from matplotlib.animation import FFMpegWriter

    speed: Any = FRAMES / SKIPPED
    writer = FFMpegWriter(fps=speed)
    with writer.saving(stage.figure, path, DPI):
        for frame in frames:
            _draw_frame(stage, frame)
            writer.grab_frame()
            progress(1)


def _write_gif(stage: Stage, frames: range, path: Path, progress: Callable[[int], None]) -> None:
    """Write a GIF of some frames, in few colours. Each picture keeps the unchanged parts.

    Its comment is the run's title.

    Args:
        stage: the figure, and what moves on it.
        frames: the frames.
        path: the file.
        progress: called with 1 for each frame done.
    """
    from PIL.Image import Dither

    palette = _render_picture(stage, frames[-1]).quantize(COLOURS)

    def pictures() -> Iterator[Image]:
        """Yield the picture of each frame, in few colours."""
        for frame in frames:
            picture = _render_picture(stage, frame)
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


def _render_picture(stage: Stage, frame: int) -> Image:
    """Return the picture of the figure at a frame."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL.Image import fromarray

    _draw_frame(stage, frame)
    canvas: Any = FigureCanvasAgg(stage.figure)
    canvas.draw()
    return fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


class Stage(NamedTuple):
    """Figure on which arms move: a line and a trail of the tip for each arm, its title."""

    figure: Figure
    axes: Any
    arms: list[Arm]
    lines: list[Any]
    trails: list[Any]
    spatial: bool
    title: str


def _build_stage(run: Run, arms: list[Arm]) -> Stage:
    """Return the figure with the path and its limits, and lines without points yet."""
    from matplotlib.figure import Figure

    spatial = _is_spatial(run)
    figure = Figure(figsize=(6.4, 6.0), dpi=DPI, layout="constrained")
    axes: Any = figure.add_subplot(projection="3d" if spatial else None)
    dimensions = 3 if spatial else 2
    path = _tip_path(run)[:, :dimensions]
    axes.plot(*path.T, color=ink.REFERENCE, linewidth=4, alpha=0.4, label="path of the tip")
    empty: list[list[float]] = [[]] * dimensions
    lines = []
    trails = []
    for arm in arms:
        lines += axes.plot(*empty, color=arm.colour, marker="o", markersize=4, linewidth=3)
    for arm in arms:
        trails += axes.plot(*empty, color=arm.colour, linewidth=1.2, alpha=0.7)
    for line, arm in zip(lines, arms, strict=True):
        line.set_label(escape_formulas(arm.label))
    points = [arm.poses.reshape(-1, 3)[:, :dimensions] for arm in arms]
    _apply_equal_limits(axes, np.vstack([path, *points]))
    if spatial:
        axes.view_init(elev=np.degrees(TILT), azim=np.degrees(-_view_turn(run)) - 90)
        axes.set_box_aspect((1, 1, 1), zoom=1.15)
    axes.grid(visible=True, alpha=0.4)
    figure.legend(loc="outside lower center", fontsize=9, ncols=2, frameon=False)
    return Stage(figure, axes, arms, lines, trails, spatial, escape_formulas(run.info.title))


def _apply_equal_limits(axes: Any, points: Floats) -> None:
    """Set equally scaled axes that contain all points, with their labels."""
    low = points.min(axis=0)
    high = points.max(axis=0)
    middle = (low + high) / 2
    reach = 0.53 * float(np.ptp(points, axis=0).max())
    for name, centre in zip("xyz", middle, strict=False):
        getattr(axes, f"set_{name}lim")(centre - reach, centre + reach)
        getattr(axes, f"set_{name}label")(f"{name} [m]")
    axes.locator_params(nbins=5)
    axes.set_aspect("equal")


def _draw_frame(stage: Stage, frame: int) -> None:
    """Move every arm to its pose in a frame, with the last way of its tip."""
    for line, trail, arm in zip(stage.lines, stage.trails, stage.arms, strict=True):
        now = min(frame, len(arm.poses) - 1)
        before = max(0, now - round(TRAIL * FRAMES))
        _move_line(line, arm.poses[now], stage.spatial)
        _move_line(trail, arm.poses[before : now + 1, -1], stage.spatial)
    stage.axes.set_title(f"{stage.title}, t = {frame / FRAMES:.2f} s", fontsize=9)


def _move_line(line: Any, points: Floats, spatial: bool) -> None:
    """Set the points of a line (N x 3)."""
    line.set_data(*points[:, :2].T)
    if spatial:
        line.set_3d_properties(points[:, 2])


def count_frames(run: Run) -> int:
    """Return the number of frames that a file shows of a run."""
    return 0 if run.poses is None else -(-len(run.poses) // SKIPPED)


def _build_arms(run: Run, rival: Run | None) -> list[Arm]:
    """Return the arms on display, each until it diverged, the run's own last, above the rival's."""
    own = _build_arm(run, ink.ESTIMATE)
    return [own] if rival is None else [_build_arm(rival, ink.PRINTED), own]


def _build_arm(run: Run, colour: str) -> Arm:
    """Return the arm of a run, until it diverged."""
    assert run.poses is not None
    end = len(run.poses)
    if run.divergence_time is not None:
        end = max(1, int(run.divergence_time * FRAMES))
    return Arm(run.observer_name, colour, run.poses[:end], run.rms_tip or 0.0)


def _tip_path(run: Run) -> Floats:
    """Return the path of the tip's reference (frames x 3) [m]."""
    assert run.tip_r is not None
    thin = run.tip_r[:: max(1, round(1 / FRAMES / run.info.step))]
    return np.pad(thin, ((0, 0), (0, 3 - thin.shape[1])))


def _is_spatial(run: Run) -> bool:
    """Return whether the arm moves in space, not in a plane."""
    return run.tip is not None and run.tip.shape[1] == 3


def _view_turn(run: Run) -> float:
    """Return the angle about z by which the drawing of an arm is turned [rad]; 0 in a plane.

    The turned drawing shows the middle of the tip's path to the right of the base, in one of the
    directions `SIDEWAYS`. Of these, the drawing uses that in which the plane of the path is seen
    most from the front.
    """
    assert run.poses is not None
    if not _is_spatial(run):
        return 0.0
    path = _tip_path(run)
    centre = path.mean(axis=0)
    x, y, _ = centre - run.poses[0, 0]
    # The direction in which the path varies least is the normal of its plane.
    normal = np.linalg.svd(path - centre, full_matrices=False)[2][-1]
    turns = [direction - float(np.arctan2(y, x)) for direction in SIDEWAYS]
    return max(turns, key=lambda turn: visible_face_share(normal, turn))


def visible_face_share(normal: Floats, turn: float) -> float:
    """Return the visible share of a plane's face after a turn [rad] about z: 1 all, 0 nothing."""
    eye = -np.cos(TILT) * np.sin(turn), -np.cos(TILT) * np.cos(turn), np.sin(TILT)
    return abs(float(normal @ eye))


def _grid_spacing(size: float) -> float:
    """Return the distance [m] of some five to ten lines over a size [m]: 1, 2 or 5 times 10^k."""
    size = max(size, 1e-3)
    power = 10.0 ** np.floor(np.log10(size / 5))
    fitting = [factor for factor in (1, 2, 5) if factor * power <= size / 5 + 1e-12]
    return float(power * max(fitting))


def _round_for_screen(values: Floats) -> list[object]:
    """Return values rounded to tenths of a millimetre [m], the resolution of a screen."""
    return list(np.round(values, 4).tolist())
