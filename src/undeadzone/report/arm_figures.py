"""Figures of an arm's run: its tip, its errors, its torques, and each joint in its phase plane.

A rival's tip and errors stand beside them where there is a rival.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from undeadzone.report.style import (
    ESTIMATE,
    OTHER,
    PRINTED,
    READING,
    REFERENCE,
    TRUTH,
    ZONE,
    axis_label,
    finish,
    plain,
    plot_magnitude,
    sheet,
)
from undeadzone.results.run import Run
from undeadzone.support.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (TRUTH, ESTIMATE, READING, REFERENCE, PRINTED, OTHER)  # of joints
COLUMNS = 3  # joints in a row
LEGEND: Any = {"frameon": False, "fontsize": 8.5}
BEYOND = 0.25  # share of the truth's range by which a phase plane shows more

PLANAR = [["x-y", "error"], ["x-y", "torque"]]
SPATIAL = [["x-y"] * 3 + ["x-z"] * 3, ["error"] * 3 + ["torque"] * 3]
PLANES = {"x-y": (0, 1), "x-z": (0, 2)}  # coordinates to the right and upwards


def tip(run: Run, rival: Run | None = None) -> Figure:
    """The tip on its path in each plane it moves in, its distance from the path, the torques."""
    assert run.tip is not None
    spatial = run.tip.shape[1] == 3
    title = f"{run.info.title}: the tip"
    if spatial:
        figure, panels = sheet(SPATIAL, title, height=3.2)
        for name, plane in PLANES.items():
            _plane(panels[name], run, rival, plane, f" in {name}")
    else:
        figure, panels = sheet(PLANAR, title, height=3.2)
        _plane(panels["x-y"], run, rival, PLANES["x-y"], "")
    figure.legend(*panels["x-y"].get_legend_handles_labels(), loc="upper right", ncols=3, **LEGEND)
    _distances(panels["error"], run, rival)
    _torques(panels["torque"], run)
    return figure


def _distances(axes: Axes, run: Run, rival: Run | None) -> None:
    """The distance of each tip from its path."""
    for one, colour in _both(run, rival):
        assert one.tip is not None
        assert one.tip_r is not None
        distance = np.linalg.norm(one.tip - one.tip_r, axis=1)
        plot_magnitude(axes, one.t[one.shown], distance[one.shown], colour, plain(one.name))
    finish(axes, "Distance of the tip from where it should be", axis_label("distance", "m"))


def _torques(axes: Axes, run: Run) -> None:
    """The torque of each motor."""
    t = run.t[run.shown]
    motors = run.info.joints[: run.u.shape[1]]  # names of the joints that have one
    for i, name in enumerate(motors):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(t, run.u[run.shown, i], color=colour, linewidth=0.9, label=plain(name))
    finish(axes, "Torques", axis_label("u", run.unit("u")), legend=3)


def phase(run: Run) -> Figure:
    """Position and velocity of each joint, truth and estimate.

    The dead zone is shown where it lies in the position.
    """
    rows = joint_rows(len(run.info.joints))
    figure, panels = sheet(rows, f"{run.info.title}: phase planes", height=2.8)
    for i, name in enumerate(run.info.joints):
        _phase_plane(panels[f"{i}"], run, i, name)
    figure.legend(*panels["0"].get_legend_handles_labels(), loc="upper right", ncols=3, **LEGEND)
    return figure


def joint_rows(joints: int) -> list[list[str]]:
    """The panels of joints, some in a row; a dot is an empty place after the last one."""
    columns = min(COLUMNS, joints)
    rows = []
    for first in range(0, joints, COLUMNS):
        row = [f"{i}" for i in range(first, min(first + columns, joints))]
        rows.append(row + ["."] * (columns - len(row)))
    return rows


def _phase_plane(axes: Axes, run: Run, i: int, name: str) -> None:
    """Velocity over position of joint i, truth and estimate."""
    velocity = len(run.info.joints) + i  # its place in x
    q, q_rate = run.x[run.shown, i], run.x[run.shown, velocity]
    q_hat, q_hat_rate = run.x_hat[run.shown, i], run.x_hat[run.shown, velocity]
    _zone(axes, run, i)
    axes.plot(q, q_rate, color=TRUTH, linewidth=1.3, linestyle="-", label="truth")
    axes.plot(
        q_hat, q_hat_rate, color=ESTIMATE, linewidth=0.9, linestyle=(0, (4, 2)), label="estimate"
    )
    axes.set_xlim(*_range(q))
    axes.set_ylim(*_range(q_rate))
    upwards, to_the_right = run.unit(f"x[{velocity}]"), run.unit(f"x[{i}]")
    finish(axes, name, axis_label("q'", upwards), axis_label("q", to_the_right), legend=0)


def _both(run: Run, rival: Run | None) -> list[tuple[Run, str]]:
    """Each run with its colour."""
    if rival is None:
        return [(run, ESTIMATE)]
    return [(run, ESTIMATE), (rival, PRINTED)]


def _plane(axes: Axes, run: Run, rival: Run | None, plane: tuple[int, int], where: str) -> None:
    """The tip seen along one direction, equally scaled."""
    assert run.tip_r is not None
    axes.margins(0.05)
    axes.plot(*run.tip_r[:, plane].T, color=REFERENCE, linewidth=4.0, alpha=0.4, label="path")
    for one, colour in reversed(_both(run, rival)):
        assert one.tip is not None
        first = one.t.size // 2 if one.diverged_at is None else 0
        points = one.tip[first : one.shown.stop][:, plane]
        axes.plot(*points.T, color=colour, linewidth=1.1, label=plain(one.name))
    to_the_right, upwards = (axis_label("xyz"[coordinate], "m") for coordinate in plane)
    title = f"The tip{where}, last half of the run"
    finish(axes, title, upwards, to_the_right, legend=0)
    axes.set_aspect("equal", adjustable="datalim")


def _range(values: Floats) -> tuple[float, float]:
    """Where the values lie, and a little more."""
    room = BEYOND * float(np.ptp(values)) + 1e-9
    return float(values.min()) - room, float(values.max()) + room


def _zone(axes: Axes, run: Run, i: int) -> None:
    """The dead zone of a joint whose position is read: where it lies in q."""
    if i >= run.z.shape[1]:
        return
    silent_at = offset(run.x[run.shown, i], run.z[run.shown, i])
    if silent_at is None:
        return
    right, left = run.info.widths[2 * i : 2 * i + 2]
    ends = silent_at - left, silent_at + right
    axes.axvspan(*ends, color=ZONE, alpha=0.18, linewidth=0, label="dead zone")


def offset(q: Floats, z: Floats) -> float | None:
    """q - z where that is a constant: the position at which the sensor reads 0."""
    gap = q - z
    constant = np.ptp(gap) <= 1e-9 * (1 + np.abs(gap).max())
    return float(gap[0]) if constant else None
