"""Figures of an arm's run: the tip and its path, errors, torques, and each joint in its phase plane; beside a rival's where there is one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from undeadzone.arrays import Floats
from undeadzone.report.style import ESTIMATE, OTHER, PRINTED, READING, REFERENCE, TRUTH, ZONE, finish, label, plot_magnitude, sheet
from undeadzone.run import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (TRUTH, ESTIMATE, READING, REFERENCE, PRINTED, OTHER)  # of joints
COLUMNS = 3  # joints in a row


def tip(run: Run, rival: Run | None = None) -> Figure:
    """The tip on its path in each plane that it moves in, its distance from the path, and the torques."""
    assert run.tip is not None
    planes = [(0, 1)] if run.tip.shape[1] == 2 else [(0, 1), (0, 2)]
    names = [f"plane {i}" for i in range(len(planes))]
    wide = [names[i * len(names) // 6] for i in range(6)] if len(names) > 1 else ["plane 0"] * 3 + ["error"] * 3
    below = ["error"] * 3 + ["torque"] * 3 if len(names) > 1 else ["plane 0"] * 3 + ["torque"] * 3
    figure, panels = sheet([wide, below], f"{run.info.title}: the tip", height=3.2)
    for name, plane in zip(names, planes, strict=True):
        _plane(panels[name], run, rival, plane)
    for one, colour, name in _both(run, rival):
        assert one.tip is not None
        assert one.tip_r is not None
        plot_magnitude(panels["error"], one.t, np.linalg.norm(one.tip - one.tip_r, axis=1), colour, name)
    finish(panels["error"], "Distance of the tip from where it should be", label("distance", "m"))
    for i, name in enumerate(_inputs(run)):
        panels["torque"].plot(run.t, run.u[:, i], color=COLOURS[i % len(COLOURS)], linewidth=0.9, label=name)
    finish(panels["torque"], "Torques", label("u", run.unit("u")), legend=3)
    return figure


def phase(run: Run) -> Figure:
    """Position and velocity of each joint, truth and estimate, over its dead zone where it lies in the position."""
    joints = len(run.info.joints)
    rows = [[f"{i}" if i < joints else "." for i in range(first, first + COLUMNS)] for first in range(0, joints, COLUMNS)]
    rows = [row[: max(1, joints)] for row in rows]
    figure, panels = sheet(rows, f"{run.info.title}: the joints in their phase planes", height=2.8)
    for i, name in enumerate(run.info.joints):
        axes = panels[f"{i}"]
        _zone(axes, run, i)
        axes.plot(run.x[:, i], run.x[:, joints + i], color=TRUTH, label="truth")
        axes.plot(run.x_hat[:, i], run.x_hat[:, joints + i], color=ESTIMATE, linewidth=0.9, linestyle=(0, (4, 2)), label="estimate")
        finish(axes, name, label("q'", run.unit(f"x[{joints + i}]")), label("q", run.unit(f"x[{i}]")), legend=2 * (i == 0))
    return figure


def _inputs(run: Run) -> list[str]:
    """The names of the joints that have a motor."""
    return run.info.joints[: run.u.shape[1]]


def _both(run: Run, rival: Run | None) -> list[tuple[Run, str, str]]:
    """Each run with its colour and its name."""
    return [(run, ESTIMATE, run.info.method)] + ([] if rival is None else [(rival, PRINTED, f"compared: {rival.info.method}")])


def _plane(axes: Axes, run: Run, rival: Run | None, plane: tuple[int, int]) -> None:
    assert run.tip_r is not None
    axes.plot(*run.tip_r[:, plane].T, color=REFERENCE, linewidth=4.0, alpha=0.4, label="path")
    for one, colour, name in reversed(_both(run, rival)):
        assert one.tip is not None
        shown = one.tip[_settled(one)]
        axes.plot(*shown[:, plane].T, color=colour, linewidth=1.1, label=name)
    finish(axes, "The tip, last half of the run", label("xyz"[plane[1]], "m"), label("xyz"[plane[0]], "m"), legend=3)
    axes.set_aspect("equal", adjustable="box")


def _settled(run: Run) -> slice:
    end = None if run.diverged_at is None else int(np.searchsorted(run.t, run.diverged_at))
    return slice(0 if end is not None else run.t.size // 2, end)


def _zone(axes: Axes, run: Run, i: int) -> None:
    """The dead zone of a joint whose position is read: where it lies in q."""
    right, left = run.info.widths[2 * i : 2 * i + 2] if 2 * i + 1 < len(run.info.widths) else (0.0, 0.0)
    offset = _offset(run.x[:, i], run.z[:, i]) if i < run.z.shape[1] else None
    if offset is not None:
        axes.axvspan(offset - left, offset + right, color=ZONE, alpha=0.18, linewidth=0, label="dead zone")


def _offset(q: Floats, z: Floats) -> float | None:
    """q - z where that is a constant: the position at which the sensor reads 0."""
    gap = q - z
    return float(gap[0]) if np.ptp(gap) <= 1e-9 * (1 + np.abs(gap).max()) else None
