"""Error of the few lines that compensate a finding, measured before they are printed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.play import levels
from undeadzone.nonlinearities.sensor import deadzone
from undeadzone.util.arrays import Floats
from undeadzone_identify.models.likelihood import root_mean_square
from undeadzone_identify.results.assemble import Answer
from undeadzone_identify.selection.alternatives import fit_of, train_fit
from undeadzone_identify.servo.observations import NORMAL

if TYPE_CHECKING:
    from undeadzone_export.snippet import Lost

DEEP = 0.7  # of an edge, up to which z is surely inside
FEWEST = 8  # readings inside a zone, from which their noise is known


def rest_noise(answer: Answer) -> float:
    """Return the rms of the readings well inside the sensor's zone, 0 without any [y].

    Args:
        answer: to a log.
    """
    if answer.right is None or answer.left is None or not answer.zone:
        return 0.0
    grid, z = answer.case.grid, answer.hidden_output
    is_deep = (-DEEP * answer.left.value < z) & (z < DEEP * answer.right.value)
    inside = grid.y[grid.ok & is_deep]
    return NORMAL * float(np.median(np.abs(inside))) if inside.size >= FEWEST else 0.0


def command_along(answer: Answer) -> Floats:
    """Return the signal ahead of a zone of the input, or of a gap, in the unit of its widths (N).

    Args:
        answer: to a log.
    """
    if answer.verdict == "play":
        return answer.hidden_output
    return answer.case.grid.u[:, 0]


def measure_lines(
    numbers: dict[str, Any], answer: Answer | None, command: Floats
) -> dict[str, Any] | None:
    """Return the rms errors without and with the lines that compensate a finding.

    A sensor's lines are applied to held-out readings, with edges and plant of a fit to the other
    ones, and compared to the z that this plant simulates. Those of an actuator or of a gap are
    applied to the command, ahead of a machine with the edges at either end of their intervals: the
    larger error counts.

    Args:
        numbers: of the answer, as in identify.json.
        answer: to a log; None: to two positions.
        command: along the log, in the unit of the widths (N).

    Returns:
        `without`, `with` and `on`, on what; None if nothing is certain, or no few lines help.
    """
    from undeadzone_export.snippet import build_lost, load_lines

    try:
        lost = build_lost(numbers, "", "")
    except InputError:
        return None
    if lost.kind == "sensor" and answer is not None:
        z, y, lost = _held_out_readings(answer, lost)
        pairs, on = [(y - z, _apply(load_lines(lost), y) - z)], "held-out data"
    else:
        lines = _apply(load_lines(lost), command + lost.rest) - lost.rest
        pairs = [
            (pass_machine(lost, command, end) - command, pass_machine(lost, lines, end) - command)
            for end in (1, 2)
        ]
        on = "a simulated machine"
    errors = [(root_mean_square(one), root_mean_square(other)) for one, other in pairs]
    without, remaining = max(errors, key=lambda pair: pair[1])
    return {"without": without, "with": remaining, "on": on}


def _apply(lines: Any, values: Floats) -> Floats:
    """Return what the lines make of values, one after the other (N)."""
    return np.array(list(map(lines, values.tolist())))


def pass_machine(lost: Lost, command: Floats, end: int) -> Floats:
    """Return what an actuator with a zone, or an axis with a gap, makes of a command (N).

    Args:
        lost: its edges.
        command: in their unit, from rest (N).
        end: of their intervals: 0 for the value, 1 for the low end, 2 for the high one.
    """
    if lost.kind == "backlash":
        gap = np.array([lost.width[end]])
        return levels(command, gap, 0 * gap, command[:1])
    return deadzone(command, lost.right[end], lost.left[end])


def _held_out_readings(answer: Answer, lost: Lost) -> tuple[Floats, Floats, Lost]:
    """Return simulated z and readings that had no part in a fit (N), and the edges of that fit."""
    case, scale = answer.case, answer.scale
    fit = fit_of(case, answer.found, answer.verdict)
    if fit is None:
        z, y, test = answer.z * scale, case.grid.y, case.grid.ok
    else:
        theta, test = train_fit(fit, case.options.held_out)
        scale = fit.squares.data.y_scale
        z, y = scale * fit.model.output(theta), scale * fit.squares.data.y
        right, left = ((one, one, one) for one in (scale * fit.model.levels(theta)[:2]).tolist())
        lost = lost._replace(right=right) if lost.absent != "right" else lost
        lost = lost._replace(left=left) if lost.absent != "left" else lost
    return z[test] + lost.rest, y[test] + lost.rest, lost
