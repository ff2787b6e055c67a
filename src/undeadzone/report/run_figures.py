"""Figures of a run: readings, estimates, errors, and an arm's tip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from undeadzone.report import ink
from undeadzone.report.style import (
    DASHED,
    axis_label,
    create_panels,
    draw_width_lines,
    escape_formulas,
    finish_panel,
    plot_magnitude,
    shade_gap,
    shade_zone,
)
from undeadzone.results.run import Run
from undeadzone.util.arrays import Floats
from undeadzone.util.files import read_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STACKED = 2  # outputs, whose errors and widths stand below them; those of more stand beside them
COLOURS = (ink.TRUTH, ink.ESTIMATE, ink.READING, ink.REFERENCE, ink.PRINTED, ink.OTHER)  # of joints
COLUMNS = 3  # joints in a row
LEGEND: Any = {"frameon": False, "fontsize": 8.5}
BEYOND = 0.25  # share of the truth's range by which a phase plane shows more
PLANES = {"x-y": (0, 1), "x-z": (0, 2)}  # coordinates to the right and upwards


def overview(run: Run) -> Figure:
    """Return per output: z, reading, reference and estimate over the dead zone, errors,
    widths, then V.

    Below them stand the actuators whose widths are estimated, and the plays ahead of dead zones
    whose gaps are. Many outputs have a row each. A run that diverged is drawn up to that time.
    """
    info = run.info
    outputs = run.z.shape[1]
    actuators = 0 if run.b_hat is None else run.b_hat.shape[1] // 2
    gaps = 0 if run.c_hat is None else outputs
    wide = outputs > STACKED
    layout, columns = (layout_beside, 12) if wide else (layout_below, 6)
    rows = layout(outputs, run.V is not None)
    rows += half_rows("command", "actuator", actuators, columns)
    rows += half_rows("loop", "gaps", gaps, columns)
    size = {"width": 15.0, "height": 2.2} if wide else {}
    figure, panels = create_panels(rows, info.title, **size, even=True)
    for i in range(outputs):
        of = f" {escape_formulas(str(run.outputs[i]))}" if outputs > 1 else ""
        output(panels[f"output {i}"], run, i, of)
        _draw_errors(panels[f"error {i}"], run, i, of)
        _draw_edges(panels[f"widths {i}"], run, i, "d", info.widths, f"Widths{of}")
        if gaps:
            _draw_loop(panels[f"loop {i}"], run, i, of)
            _draw_edges(panels[f"gaps {i}"], run, i, "c", info.gaps, f"Gaps of the play{of}")
    for j in range(actuators):
        of = f" {j}" if actuators > 1 else ""
        _draw_command(panels[f"command {j}"], run, j, of)
        what = f"Widths of the actuator{of}"
        _draw_edges(panels[f"actuator {j}"], run, j, "b", info.actuator, what)
    if run.V is not None:
        plot_magnitude(panels["V"], run.t[run.plot_window], run.V[run.plot_window], ink.TRUTH, "V")
        finish_panel(panels["V"], "Lyapunov function", axis_label("V", run.unit("V")), legend=0)
    return figure


def layout_below(outputs: int, with_V: bool) -> list[list[str]]:
    """Return the panels of few outputs: each output as wide as the figure, its further panels
    below.

    V stands beside the errors of the first output.
    """
    rows = []
    for i in range(outputs):
        below = [f"error {i}", f"widths {i}", *["V"] * (with_V and i == 0)]
        rows += [[f"output {i}"] * 6, np.repeat(below, 6 // len(below)).tolist()]
    return rows


def layout_beside(outputs: int, with_V: bool) -> list[list[str]]:
    """Return the panels of many outputs: a row each, with its further panels, and V below all."""
    rows = [[f"output {i}"] * 6 + [f"error {i}"] * 3 + [f"widths {i}"] * 3 for i in range(outputs)]
    return [*rows, ["V"] * 12] if with_V else rows


def half_rows(left: str, right: str, count: int, columns: int) -> list[list[str]]:
    """Return rows of two panels for each actuator or play: its signal, and its widths or gaps."""
    half = columns // 2
    return [[f"{left} {i}"] * half + [f"{right} {i}"] * half for i in range(count)]


def output(axes: Axes, run: Run, i: int = 0, of: str = "") -> None:
    """Draw output i over its dead zone: reference, reading, truth and estimate (of: its name)."""
    window = run.plot_window
    t = run.t[window]
    right, left = run.info.widths[2 * i : 2 * i + 2]
    if run.info.sensor in ("play", "gears"):
        shade_gap(axes, t, run.y[window, i], right, left)
    else:
        at = run.info.output_level[i] if run.info.output_level else 0.0
        shade_zone(axes, right + at, left - at, run.z[window, i])
    if i in run.info.tracked:
        r = run.r[window, run.info.tracked.index(i)]
        axes.plot(t, r, color=ink.REFERENCE, linewidth=2.6, alpha=0.45, label="reference r")
    axes.plot(t, run.y[window, i], color=ink.READING, label="reading y")
    axes.plot(t, run.z[window, i], color=ink.TRUTH, label="output z")
    estimate = run.z_hat[window, i]
    axes.plot(t, estimate, color=ink.ESTIMATE, linestyle=DASHED, label="estimate ẑ")
    title = f"Output{of} and its estimate"
    if run.divergence_time is not None:
        title += f", diverged at {run.divergence_time:.4g} s"
    finish_panel(axes, title, axis_label("z, y", run.unit("z")), legend=5)


def _draw_errors(axes: Axes, run: Run, i: int, of: str) -> None:
    """Draw the sizes of the tracking error, if output i is tracked, and of the estimation
    error.
    """
    window = run.plot_window
    t = run.t[window]
    if i in run.info.tracked:
        tracking = (run.z[:, i] - run.r[:, run.info.tracked.index(i)])[window]
        plot_magnitude(axes, t, tracking, ink.REFERENCE, "|z - r|")
    plot_magnitude(axes, t, (run.z - run.z_hat)[window, i], ink.ESTIMATE, "|z - ẑ|")
    finish_panel(axes, f"Errors{of}", axis_label("error", run.unit("z")))


def _draw_command(axes: Axes, run: Run, j: int, of: str) -> None:
    """Draw input j over the dead zone of its actuator."""
    right, left = run.info.actuator[2 * j : 2 * j + 2]
    at = run.info.input_level[j] if run.info.input_level else 0.0
    shade_zone(axes, right + at, left - at)
    axes.plot(run.t[run.plot_window], run.u[run.plot_window, j], color=ink.TRUTH)
    finish_panel(
        axes, f"Command{of} over the actuator's zone", axis_label("u", run.unit("u")), legend=0
    )


def _draw_loop(axes: Axes, run: Run, i: int, of: str) -> None:
    """Draw the readings of output i over the true output and its estimate, at the end of the
    run.
    """
    last = slice(2 * run.t.size // 3, None)
    axes.plot(run.z[last, i], run.y[last, i], color=ink.TRUTH, label="z")
    z_hat = run.z_hat[last, i]
    axes.plot(z_hat, run.y[last, i], color=ink.ESTIMATE, linestyle=DASHED, label="ẑ")
    title = f"Reading{of} over the output, last third"
    unit = run.unit("z")
    finish_panel(axes, title, axis_label("y", run.unit("y")), axis_label("z", unit))


def _draw_edges(
    axes: Axes, run: Run, i: int, letter: str, true: Sequence[float], what: str
) -> None:
    """Draw the estimated right and left edge of a zone or a play over the true edges.

    Args:
        axes: to draw on.
        run: run to show.
        i: which sensor or actuator it is.
        letter: of its widths.
        true: of all of them.
        what: it is.
    """
    columns = slice(2 * i, 2 * i + 2)
    name = f"{letter}_hat"
    for value, colour in zip(true[columns], (ink.PRINTED, ink.OTHER), strict=True):
        axes.axhline(value, color=colour, linewidth=3.0, alpha=0.3)
    found = getattr(run, name)
    std = getattr(run, f"{letter}_std")
    band = None if std is None else std[run.plot_window, columns]
    draw_width_lines(axes, run.t[run.plot_window], found[run.plot_window, columns], band)
    finish_panel(axes, f"{what}, truth pale", axis_label(letter, run.unit(name)))


def plot_tip(run: Run, rival: Run | None = None) -> Figure:
    """Return the tip on its path in each plane of its motion, its distance from the path, the
    torques.
    """
    assert run.tip is not None
    spatial = run.tip.shape[1] == 3
    title = f"{run.info.title}: the tip"
    rows = read_table(__file__)["spatial" if spatial else "planar"]
    figure, panels = create_panels(rows, title, height=3.2)
    for name, plane in PLANES.items():
        if name in panels:
            _draw_tip_plane(panels[name], run, rival, plane, f" in {name}" if spatial else "")
    figure.legend(*panels["x-y"].get_legend_handles_labels(), loc="upper right", ncols=3, **LEGEND)
    _draw_tip_distances(panels["error"], run, rival)
    _draw_torques(panels["torque"], run)
    return figure


def _draw_tip_distances(axes: Axes, run: Run, rival: Run | None) -> None:
    """Draw the distance of each tip from its path."""
    for one, colour in _runs_with_colours(run, rival):
        assert one.tip is not None
        assert one.tip_r is not None
        distance = np.linalg.norm(one.tip - one.tip_r, axis=1)
        plot_magnitude(
            axes,
            one.t[one.plot_window],
            distance[one.plot_window],
            colour,
            escape_formulas(one.observer_name),
        )
    finish_panel(axes, "Distance of the tip from its desired place", axis_label("distance", "m"))


def _draw_torques(axes: Axes, run: Run) -> None:
    """Draw the torque of each motor."""
    t = run.t[run.plot_window]
    motors = run.info.joints[: run.u.shape[1]]  # names of the joints that have one
    for i, name in enumerate(motors):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(
            t, run.u[run.plot_window, i], color=colour, linewidth=0.9, label=escape_formulas(name)
        )
    finish_panel(axes, "Torques", axis_label("u", run.unit("u")), legend=3)


def plot_phase(run: Run) -> Figure:
    """Return position and velocity of each joint, truth and estimate.

    The dead zone is shown if it lies in the position.
    """
    rows = joint_rows(len(run.info.joints))
    figure, panels = create_panels(rows, f"{run.info.title}: phase planes", height=2.8)
    for i, name in enumerate(run.info.joints):
        _draw_phase_plane(panels[f"{i}"], run, i, name)
    figure.legend(*panels["0"].get_legend_handles_labels(), loc="upper right", ncols=3, **LEGEND)
    return figure


def joint_rows(joints: int) -> list[list[str]]:
    """Return the panels of joints, some in a row. A dot is an empty place after the last
    joint.
    """
    columns = min(COLUMNS, joints)
    names = [*map(str, range(joints)), *["."] * (-joints % columns)]
    return [names[first : first + columns] for first in range(0, len(names), columns)]


def _draw_phase_plane(axes: Axes, run: Run, i: int, name: str) -> None:
    """Draw velocity over position of joint i, truth and estimate."""
    states = run.x.shape[1]
    joints = len(run.info.joints)
    # behind those of motors
    position = states // 2 - joints + i
    velocity = states - joints + i
    q = run.x[run.plot_window, position]
    q_rate = run.x[run.plot_window, velocity]
    found = run.x_hat[run.plot_window, position], run.x_hat[run.plot_window, velocity]
    _shade_joint_zone(axes, run, i)
    axes.plot(q, q_rate, color=ink.TRUTH, linewidth=1.3, linestyle="-", label="truth")
    axes.plot(*found, color=ink.ESTIMATE, linewidth=0.9, linestyle=DASHED, label="estimate")
    axes.set_xlim(*_range_with_margin(q))
    axes.set_ylim(*_range_with_margin(q_rate))
    upwards = run.unit(f"x[{velocity}]")
    to_the_right = run.unit(f"x[{position}]")
    finish_panel(axes, name, axis_label("q'", upwards), axis_label("q", to_the_right), legend=0)


def _runs_with_colours(run: Run, rival: Run | None) -> list[tuple[Run, str]]:
    """Return each run with its colour."""
    runs = [run] if rival is None else [run, rival]
    return list(zip(runs, (ink.ESTIMATE, ink.PRINTED), strict=False))


def _draw_tip_plane(
    axes: Axes, run: Run, rival: Run | None, plane: tuple[int, int], where: str
) -> None:
    """Draw the tip seen along a direction, equally scaled."""
    assert run.tip_r is not None
    axes.margins(0.05)
    first = run.t.size // 2 if run.divergence_time is None else 0
    path = run.tip_r[first:, plane]
    axes.plot(*path.T, color=ink.REFERENCE, linewidth=4.0, alpha=0.4, label="path")
    for one, colour in reversed(_runs_with_colours(run, rival)):
        assert one.tip is not None
        first = one.t.size // 2 if one.divergence_time is None else 0
        points = one.tip[first : one.plot_window.stop, plane]
        axes.plot(*points.T, color=colour, linewidth=1.1, label=escape_formulas(one.observer_name))
    to_the_right, upwards = (axis_label("xyz"[coordinate], "m") for coordinate in plane)
    title = f"The tip{where}, last half of the run"
    finish_panel(axes, title, upwards, to_the_right, legend=0)
    axes.set_aspect("equal", adjustable="datalim")


def _range_with_margin(values: Floats) -> tuple[float, float]:
    """Return the range of the values, and a little more."""
    room = BEYOND * float(np.ptp(values)) + 1e-9
    return float(values.min()) - room, float(values.max()) + room


def _shade_joint_zone(axes: Axes, run: Run, i: int) -> None:
    """Draw the dead zone of a joint whose position is read, at its place in q."""
    if i >= run.z.shape[1] or run.info.sensor == "gears":
        return
    silent_at = constant_offset(run.x[run.plot_window, i], run.z[run.plot_window, i])
    right, left = run.info.widths[2 * i : 2 * i + 2]
    if silent_at is None or np.inf in (right, left):
        return
    ends = silent_at - left, silent_at + right
    axes.axvspan(*ends, color=ink.ZONE, alpha=0.18, linewidth=0, label="dead zone")


def constant_offset(q: Floats, z: Floats) -> float | None:
    """Return q - z if constant: the position at which the sensor reads 0."""
    gap = q - z
    constant = np.ptp(gap) <= 1e-9 * (1 + np.abs(gap).max())
    return float(gap[0]) if constant else None
