"""Animation of an arm: a drawing that plays inside a page, which fetches nothing for it."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from undeadzone.report import ink
from undeadzone.report.html import Html, format_html
from undeadzone.results.run import FRAMES, Run
from undeadzone.util.arrays import Floats

TILT = 0.35  # [rad] by which an arm in space is seen from above
SIDEWAYS = (0.5, 0.9, -0.9, -0.5)  # directions of an arm's path [rad], 0: right in the drawing

_CANVAS = '<canvas width="880" height="520" role="img" aria-label="The arm in motion"></canvas>'
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
    """

    name: str
    colour: str
    poses: Floats


def animation_canvas(run: Run, rival: Run | None = None) -> Html:
    """Return a canvas that plays the arm on the tip's path, and a rival's in a second colour.

    Arms in space turn under the mouse.
    """
    arms = build_arms(run, rival)
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


def build_arms(run: Run, rival: Run | None) -> list[Arm]:
    """Return the arms on display, each until it diverged, the run's own last, above the rival's."""
    own = _build_arm(run, ink.ESTIMATE)
    return [own] if rival is None else [_build_arm(rival, ink.PRINTED), own]


def _build_arm(run: Run, colour: str) -> Arm:
    """Return the arm of a run, until it diverged."""
    assert run.poses is not None
    end = len(run.poses)
    if run.divergence_time is not None:
        end = max(1, int(run.divergence_time * FRAMES))
    return Arm(run.observer_name, colour, run.poses[:end])


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
