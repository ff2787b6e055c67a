"""Figures of an identified log: with a zone of the sensor, or with another element."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from undeadzone.nonlinearities.sensor import jump
from undeadzone.report import ink
from undeadzone.report.style import create_panels, escape_formulas, finish_panel
from undeadzone.util.text import HALF_95, label_with_unit
from undeadzone_identify.models.zone_fit import mean_reading
from undeadzone_identify.results.next_log import NextLog
from undeadzone_identify.results.result import Identified
from undeadzone_identify.results.words import crossing_columns
from undeadzone_identify.selection.decision import MODELS
from undeadzone_identify.selection.orders import training_samples

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from undeadzone.util.arrays import Floats
    from undeadzone_identify.results.at_rest import IdentifiedAtRest
    from undeadzone_identify.results.loop import IdentifiedLoop
    from undeadzone_identify.results.lost_motion import IdentifiedMotion
    from undeadzone_identify.results.result import IdentifiedOutputs
    from undeadzone_identify.selection.alternatives import Element

WITHIN = 0.95  # quantile of the crossings that a figure is sure to show
MAPS = {"jump": "jump sensor"}  # by verdict, what the fitted sensor is called
MOST = 4000  # samples of a figure over time; of a longer log the last ones are drawn
MOST_AT_END = 600  # the same of a figure of the end of a log
NAMES = {"play": "the play", "both": "play and dead zone", "two_zones": "the dead zone"}


def build_figures(
    found_log: Identified | IdentifiedMotion | IdentifiedAtRest | IdentifiedLoop,
    further: NextLog | None = None,
) -> dict[str, Figure]:
    """Build the figures that apply to an answer.

    Args:
        found_log: the answer.
        further: the proposed record; None: not asked.

    Returns:
        Figures by name: overview, residual_map, and where there is a zone hidden; of a play, or of
        an input zone, overview and element, and of a servo crossings; next, the input to record;
        without a plant overview alone.
    """
    if not isinstance(found_log, Identified):
        return {"overview": found_log.plot()}
    drawn = {"overview": overview(found_log)}
    element = found_log.answer.element
    drawn["residual_map" if element is None else "element"] = _plot_by_output(found_log)
    if element is None and found_log.right is not None:
        drawn["hidden"] = _plot_hidden_output(found_log)
    columns = crossing_columns(found_log.answer)
    if columns:
        drawn["crossings"] = _plot_crossings(found_log, columns)
    if further is not None:
        drawn["next"] = _plot_next_input(found_log, further)
    return drawn


def _plot_next_input(found_log: Identified, further: NextLog) -> Figure:
    """Plot the input to record next."""
    figure, panels = create_panels([["u"]], "What to record next", height=2.4)
    panels["u"].plot(further.t, further.u, linewidth=0.8, drawstyle="steps-post")
    unit = found_log.answer.case.grid.input_unit
    finish_panel(
        panels["u"], further.description, label_with_unit("u", unit), _time_label(found_log)
    )
    return figure


def _time_window(found_log: Identified, most: int = MOST) -> slice:
    """Return the slice of samples that a figure over time shows: the last `most` samples."""
    size = found_log.answer.case.grid.t.size
    return slice(max(0, size - most), size)


def _time_label(found_log: Identified) -> str:
    """Return the label of the time axis, in seconds or samples."""
    return "t [samples]" if found_log.answer.case.grid.counted else "t [s]"


def overview(found_log: Identified) -> Figure:
    """Plot z^, y and the part between both over time, the held-out parts shaded."""
    part = _time_window(found_log, MOST if found_log.answer.element is None else MOST_AT_END)
    figure, panels = create_panels([["signals"]], "The log and its fit", height=3.6)
    signals(panels["signals"], found_log, part)
    return figure


def signals(axes: Axes, found_log: Identified, part: slice | None = None, of: str = "") -> None:
    """Plot z^, y and the part between both over time, the held-out parts shaded.

    Args:
        axes: where.
        found_log: the answer.
        part: samples that are shown; None: the last ones.
        of: name of the output.
    """
    part = part or _time_window(found_log)
    answer = found_log.answer
    t = answer.case.grid.t[part]
    element = answer.element
    if element is None:
        _plot_zone_bands(axes, found_log)
    axes.plot(t, answer.hidden_output[part], color=ink.ESTIMATE, label="plant's ẑ")
    _plot_readings(axes, found_log, part)
    if element is not None and element.kind in NAMES:
        expected = (element.readings * answer.scale)[part]
        axes.plot(t, expected, color=ink.OTHER, linewidth=1.0, label=f"{_name_of(element)} of it")
    _shade_held_out(axes, found_log, part)
    _finish_over_time(axes, f"Output{of} and reading. Shaded: held out", found_log)


def _finish_over_time(axes: Axes, title: str, found_log: Identified) -> None:
    """Finish a panel of output and reading over time."""
    y_label = label_with_unit("z, y", found_log.answer.case.grid.output_unit)
    finish_panel(axes, title, y_label, _time_label(found_log))


def _plot_readings(axes: Axes, found_log: Identified, part: slice) -> None:
    """Plot the readings over time, with gaps at missing samples."""
    grid = found_log.answer.case.grid
    y = np.where(grid.ok, grid.y, np.nan)[part]
    axes.plot(grid.t[part], y, color=ink.READING, linewidth=1.0, label="reading y")


def of_outputs(result: IdentifiedOutputs) -> Figure:
    """Plot the log and the fit of each output in separate panels."""
    figure, panels = create_panels([[name] for name in result.names], "The log and its fits")
    for name, one in zip(result.names, result.outputs, strict=True):
        signals(panels[name], one, None, f" {escape_formulas(name)}")
    return figure


def plot_first_fit(axes: Axes, result: IdentifiedOutputs) -> None:
    """Plot the log and the fit of the first output."""
    signals(axes, result.outputs[0])


def lost_motion(result: IdentifiedMotion) -> Figure:
    """Plot both positions over time, and the second less its share of the first by the first."""
    figure, panels = create_panels([["time"], ["flanks"]], "Two positions", height=2.6)
    one = result.answer
    axes = panels["time"]
    data = one.data
    found = one.found
    part = slice(None, MOST)
    fitted = data.y - found.residual
    axes.plot(data.t[part], fitted[part], color=ink.ESTIMATE, label="behind the lost motion")
    axes.plot(data.t[part], data.y[part], ".", color=ink.READING, markersize=2.5, label="reading y")
    unit = one.log.output_units[0]
    finish_panel(axes, "Reading and fit", label_with_unit("y", unit), "t [s]")
    both_flanks(panels["flanks"], result)
    return figure


def both_flanks(axes: Axes, result: IdentifiedMotion) -> None:
    """Plot what the second position lags behind the first, by the first: two flanks of a gap."""
    one = result.answer
    data = one.data
    found = one.found
    _plot_dots(axes, data.u, data.y - found.gain * data.u - found.level, ink.READING, "readings")
    for sign in (-1, 1):
        axes.axhline(sign * 0.5 * found.gain * one.gap.value, color=ink.ESTIMATE, linewidth=0.8)
    left = label_with_unit("y - R u - b", one.log.output_units[0])
    finish_panel(axes, "Both flanks", left, label_with_unit("u", one.log.input_unit))


def at_rest(result: IdentifiedAtRest) -> Figure:
    """Draw readings over commands at rest with the edges of each flat part.

    Args:
        result: of a log whose map at rest gave the answer.
    """
    figure, panels = create_panels([["map"]], "Map at rest", height=3.2)
    map_at_rest(panels["map"], result)
    return figure


def map_at_rest(axes: Axes, result: IdentifiedAtRest) -> None:
    """Draw the map at rest, or the readings over the commands, with shaded edges.

    Args:
        axes: where to.
        result: of a log.
    """
    log = result.log
    _plot_dots(axes, log.u[:, 0], log.y[:, 0], ink.READING, "readings")
    seen = result.looks.at_rest
    if seen is not None:
        axes.plot(seen.x, seen.predict(seen.x), color=ink.ESTIMATE, label="map at rest")
    for name in ("lower", "upper"):
        edge = result.account.first_numbers.get(name)
        if edge is not None:
            axes.axvspan(edge.low, edge.high, color=ink.ESTIMATE, alpha=0.3, lw=0)
    labels = (
        label_with_unit(log.outputs[0], log.output_units[0]),
        label_with_unit(log.inputs[0], log.input_unit),
    )
    finish_panel(axes, "Readings over commands", *labels)


def loop_over_time(result: IdentifiedLoop) -> Figure:
    """Draw PV over OP, and both over time with the set point.

    Args:
        result: of a control loop.
    """
    figure, panels = create_panels([["map", "PV"], ["map", "OP"]], "The loop", even=True)
    loop_ellipse(panels["map"], result)
    log = result.logs[0]
    shown = slice(-MOST, None)
    t, names = log.t[shown], (log.outputs[0], log.inputs[0])
    for panel, values, name in zip(("PV", "OP"), (log.y, log.u), names, strict=True):
        panels[panel].plot(t, values[shown, 0], color=ink.READING, linewidth=0.8, label=name)
        if panel == "PV" and log.r.shape[1]:
            panels[panel].plot(t, log.r[shown, 0], color=ink.ESTIMATE, linewidth=0.8, label="SP")
        finish_panel(panels[panel], "Over time", name, "samples" if log.counted else "t [s]")
    return figure


def loop_ellipse(axes: Axes, result: IdentifiedLoop) -> None:
    """Draw PV over OP of the first record: an ellipse where the valve does not follow.

    Args:
        axes: where to.
        result: of a control loop.
    """
    log = result.logs[0]
    _plot_dots(axes, log.u[-MOST:, 0], log.y[-MOST:, 0], ink.READING, "samples")
    labels = label_with_unit(log.outputs[0], log.output_units[0]), log.inputs[0]
    finish_panel(axes, "PV over OP", *labels)


def _shade_held_out(axes: Axes, found_log: Identified, part: slice) -> None:
    """Mark the held-out samples by a shaded background."""
    answer = found_log.answer
    held_out = ~training_samples(answer.fit.objective.data, answer.case.options.held_out)
    axes.fill_between(
        answer.case.grid.t[part], 0, 1, where=held_out[part], color=ink.ZONE, alpha=0.12,
        linewidth=0, transform=axes.get_xaxis_transform(),
    )  # fmt: skip


def _plot_zone_bands(axes: Axes, found_log: Identified) -> None:
    """Plot the breakpoints of the zone with their 95 % intervals."""
    words: str | None = "edges, 95 %"
    for interval, sign in ((found_log.right, 1), (found_log.left, -1)):
        if interval is None or not math.isfinite(interval.high):
            continue
        value, *ends = interval.scale_by(sign)
        axes.axhline(value, color=ink.PRINTED, linewidth=1.0)
        axes.axhspan(*ends, color=ink.PRINTED, alpha=0.25, linewidth=0, label=words)
        words = None


def _plot_hidden_output(found_log: Identified) -> Figure:
    """Plot the hidden output with its 95 % band against the reading, for the end of the log."""
    states = found_log.states()
    part = _time_window(found_log, MOST_AT_END)
    figure, panels = create_panels([["z"]], "The hidden output", height=3.2)
    axes = panels["z"]
    t = states.t[part]
    z = states.z[part]
    band = HALF_95 * states.z_std[part]
    _plot_zone_bands(axes, found_log)
    axes.fill_between(t, z - band, z + band, color=ink.ESTIMATE, alpha=0.25, linewidth=0)
    axes.plot(t, z, color=ink.ESTIMATE, label="ẑ with 95 % band")
    _plot_readings(axes, found_log, part)
    _finish_over_time(axes, "Inside the zone the sensor is silent", found_log)
    return figure


def _plot_by_output(found_log: Identified) -> Figure:
    """Plot readings by z^ with their expected values, and the rest, perhaps by u."""
    answer = found_log.answer
    grid = answer.case.grid
    element = answer.element
    unit = grid.output_unit
    figure, panels = create_panels([["map", "left"]], "What was found", height=3.4)
    by_z = label_with_unit("ẑ", unit)
    ok = grid.ok
    if element is None:
        fit = answer.fit
        ok = fit.objective.readings.ok
        expected = mean_reading(fit)
        label = MAPS.get(found_log.verdict, "dead zone")
        curve = _sensor_characteristic(found_log)
    else:
        expected = element.readings
        label = f"path of {_name_of(element)}"
        part = _time_window(found_log, MOST_AT_END)
        curve = answer.hidden_output[part], (expected * answer.scale)[part]
    z = answer.hidden_output[ok]
    _plot_dots(panels["map"], z, grid.y[ok], ink.READING, "readings")
    of_input = element is not None and element.kind not in NAMES
    if not of_input:
        panels["map"].plot(*curve, color=ink.ESTIMATE, linewidth=1.0, label=label)
    finish_panel(panels["map"], "Reading by ẑ", label_with_unit("y", unit), by_z)
    x = z
    x_label = by_z
    title = "What is left"
    if of_input:
        x = grid.u[:, 0][ok]
        x_label = label_with_unit("u", grid.input_unit)
        title = f"{title}, by the input"
    residual = (answer.fit.objective.data.y - expected) * answer.scale
    _plot_dots(panels["left"], x, residual[ok], ink.ZONE)
    finish_panel(panels["left"], title, label_with_unit("y - E[y]", unit), x_label, legend=0)
    return figure


def _sensor_characteristic(found_log: Identified) -> tuple[Floats, Floats]:
    """Return z in ascending order, and the mean reading of the fitted sensor there [y] (N each)."""
    answer = found_log.answer
    fit = answer.fit
    jumps = answer.case.jump_edges
    z = np.sort(fit.z) * answer.scale
    if jumps is None:
        return z, np.sort(mean_reading(fit)) * answer.scale  # it rises with z
    right, left = (edge.value * answer.scale for edge in jumps)
    return z, jump(z, right, left)


def _name_of(element: Element) -> str:
    """Return the name of an element in a legend."""
    return NAMES.get(element.kind, MODELS[element.kind])


def _plot_crossings(found_log: Identified, columns: dict[str, Floats]) -> Figure:
    """Plot the gap at each crossing by time, y and duration, with the printed interval shaded."""
    unit = found_log.answer.case.grid.output_unit
    width = found_log.width
    figure, panels = create_panels([["t", "y", "duration"]], "The gap at each crossing", height=3.0)
    places = {
        "t": _time_label(found_log),
        "y": label_with_unit("y", unit),
        "duration": "duration [s]",
    }
    middle, *ends = np.quantile(columns["gap"], [0.5, 1 - WITHIN, WITHIN])
    reach = 2 * np.ptp(ends)
    for name, x_label in places.items():
        axes = panels[name]
        if width is not None:
            axes.axhspan(width.low, width.high, color=ink.ZONE, alpha=0.3, linewidth=0)
        for side, colour, word in ((1, ink.ESTIMATE, "to the right"), (-1, ink.OTHER, "left")):
            own = columns["side"] == side
            axes.plot(columns[name][own], columns["gap"][own], ".", color=colour, label=word)
        axes.set_ylim(middle - reach, middle + reach)
        finish_panel(axes, f"By {name}", label_with_unit("gap", unit), x_label)
    return figure


def _plot_dots(axes: Axes, x: Floats, y: Floats, colour: str, name: str | None = None) -> None:
    """Plot single readings or residuals as dots."""
    axes.plot(x, y, ".", color=colour, markersize=1.5, alpha=0.5, label=name, rasterized=True)
