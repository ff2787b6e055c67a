"""Figures of an arm's run: the tip and its path, errors, torques, and each joint in its phase plane; beside a rival's where there is one."""

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
    finish,
    label,
    plot_magnitude,
    sheet,
)
from undeadzone.simulation.run import Run
from undeadzone.support.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (TRUTH, ESTIMATE, READING, REFERENCE, PRINTED, OTHER)  # of joints
COLUMNS = 3  # joints in a row
LEGEND: Any = {"frameon": False, "fontsize": 8.5}
BEYOND = 0.25  # share of the truth's range by which a phase plane shows more


def tip(run: Run, rival: Run | None = None) -> Figure:
    """The tip on its path in each plane that it moves in, its distance from the path, and the torques."""
    assert run.tip is not None
    spatial = run.tip.shape[1] == 3
    rows = (
        [["x-y"] * 3 + ["x-z"] * 3, ["error"] * 3 + ["torque"] * 3]
        if spatial
        else [["x-y", "error"], ["x-y", "torque"]]
    )
    figure, panels = sheet(rows, f"{run.info.title}: the tip", height=3.2)
    for name, plane in (("x-y", (0, 1)), ("x-z", (0, 2)))[: 1 + spatial]:
        _plane(panels[name], run, rival, plane, f" in {name}" if spatial else "")
    figure.legend(*panels["x-y"].get_legend_handles_labels(), loc="upper right", ncols=3, **LEGEND)
    for one, colour in _both(run, rival):
        assert one.tip is not None
        assert one.tip_r is not None
        plot_magnitude(
            panels["error"],
            one.t[one.shown],
            np.linalg.norm(one.tip - one.tip_r, axis=1)[one.shown],
            colour,
            one.name,
        )
    finish(panels["error"], "Distance of the tip from where it should be", label("distance", "m"))
    for i, name in enumerate(_inputs(run)):
        panels["torque"].plot(
            run.t[run.shown],
            run.u[run.shown, i],
            color=COLOURS[i % len(COLOURS)],
            linewidth=0.9,
            label=name,
        )
    finish(panels["torque"], "Torques", label("u", run.unit("u")), legend=3)
    return figure


def phase(run: Run) -> Figure:
    """Position and velocity of each joint, truth and estimate, over its dead zone where it lies in the position."""
    joints = len(run.info.joints)
    cells = [f"{i}" if i < joints else "." for i in range(-(-joints // COLUMNS) * COLUMNS)]
    rows = [cells[first : first + COLUMNS][:joints] for first in range(0, joints, COLUMNS)]
    figure, panels = sheet(rows, f"{run.info.title}: phase planes", height=2.8)
    for i, name in enumerate(run.info.joints):
        axes = panels[f"{i}"]
        _zone(axes, run, i)
        for x, colour, width, dashes, what in (
            (run.x, TRUTH, 1.3, "-", "truth"),
            (run.x_hat, ESTIMATE, 0.9, (0, (4, 2)), "estimate"),
        ):
            axes.plot(
                x[run.shown, i],
                x[run.shown, joints + i],
                color=colour,
                linewidth=width,
                linestyle=dashes,
                label=what,
            )
        axes.set_xlim(*_range(run.x[run.shown, i]))
        axes.set_ylim(*_range(run.x[run.shown, joints + i]))
        finish(
            axes,
            name,
            label("q'", run.unit(f"x[{joints + i}]")),
            label("q", run.unit(f"x[{i}]")),
            legend=0,
        )
    figure.legend(*panels["0"].get_legend_handles_labels(), loc="upper right", ncols=3, **LEGEND)
    return figure


def _inputs(run: Run) -> list[str]:
    """The names of the joints that have a motor."""
    return run.info.joints[: run.u.shape[1]]


def _both(run: Run, rival: Run | None) -> list[tuple[Run, str]]:
    """Each run with its colour."""
    return [(run, ESTIMATE)] + ([] if rival is None else [(rival, PRINTED)])


def _plane(axes: Axes, run: Run, rival: Run | None, plane: tuple[int, int], where: str) -> None:
    """The tip seen along one direction, equally scaled."""
    assert run.tip_r is not None
    axes.margins(0.05)
    axes.plot(*run.tip_r[:, plane].T, color=REFERENCE, linewidth=4.0, alpha=0.4, label="path")
    for one, colour in reversed(_both(run, rival)):
        assert one.tip is not None
        half = slice(one.t.size // 2 if one.diverged_at is None else 0, one.shown.stop)
        axes.plot(*one.tip[half][:, plane].T, color=colour, linewidth=1.1, label=one.name)
    finish(
        axes,
        f"The tip{where}, last half of the run",
        label("xyz"[plane[1]], "m"),
        label("xyz"[plane[0]], "m"),
        legend=0,
    )
    axes.set_aspect("equal", adjustable="datalim")


def _range(values: Floats) -> tuple[float, float]:
    """Where the values lie, and a little more."""
    room = BEYOND * float(np.ptp(values)) + 1e-9
    return float(values.min()) - room, float(values.max()) + room


def _zone(axes: Axes, run: Run, i: int) -> None:
    """The dead zone of a joint whose position is read: where it lies in q."""
    if (
        i < run.z.shape[1]
        and (offset := _offset(run.x[run.shown, i], run.z[run.shown, i])) is not None
    ):
        right, left = run.info.widths[2 * i : 2 * i + 2]
        axes.axvspan(
            offset - left, offset + right, color=ZONE, alpha=0.18, linewidth=0, label="dead zone"
        )


def _offset(q: Floats, z: Floats) -> float | None:
    """q - z where that is a constant: the position at which the sensor reads 0."""
    gap = q - z
    return float(gap[0]) if np.ptp(gap) <= 1e-9 * (1 + np.abs(gap).max()) else None
