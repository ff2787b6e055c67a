"""Identifiability of dead zones of both sensor and actuator.

With b = `[b_r; b_l]` of every input among the unknowns, a change (v, c, b) stays invisible if A v -
B chi_j b lies in U for each mode j that the actuator visits, chi = (m_r, 0) on the right, (0, -m_l)
on the left, 0 if it is silent (docs/actuator.md has the proof).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule
from undeadzone.analysis.identifiability.linear import WidthIdentifiability, unobservable_changes
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.actuator import Drive, through_zone
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats


class SensorActuatorIdentifiability(NamedTuple):
    """Identifiability of the widths of sensor and actuator.

    Attributes:
        outputs: identifiability of the widths of each output's sensor (p).
        inputs: identifiability of the widths of each input's actuator (m).
    """

    outputs: list[WidthIdentifiability]
    inputs: list[WidthIdentifiability]


def actuator_modes(u: Floats, visible: np.ndarray, drive: Drive, least: int) -> Floats:
    """Return the modes of the actuators that last while an output is visible (K x m).

    Args:
        u: commands (N x m) [u].
        visible: flags of samples at which a sensor is outside its zone (N).
        drive: the true actuator.
        least: a mode counts if it lasts, in all, for more than this many samples.

    Returns:
        +1 right, -1 left, 0 silent of each input.
    """
    sides = np.sign(through_zone(np, u, drive))[visible]
    modes, counts = np.unique(sides, axis=0, return_counts=True)
    return np.asarray(modes[counts > least])


def sensor_actuator_identifiability(
    linear: Matrices,
    schedule: Schedule,
    modes: Floats,
    drive: Drive,
    bias: Floats | None = None,
) -> SensorActuatorIdentifiability:
    """Return the identifiability of the widths of sensor and actuator.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        schedule: times at which each output is on each branch of its sensor.
        modes: branches of the actuators during the run: +1, 0, -1 of each input (K x m).
        drive: the actuator, for its slopes.
        bias: effects on x' of unknown constant inputs (n x b).
    """
    n, m = linear.B.shape
    visits = schedule.branch_visits(n)
    constant = np.zeros((n, 0)) if bias is None else bias
    effects = [np.hstack([constant, _width_inputs(linear.B, mode, drive)]) for mode in modes]
    hidden = unobservable_changes(linear, visits, schedule.Ts, drives=effects or [constant])
    # Unknowns: state, widths of the sensors, constant inputs, then those of the actuators.
    ends = range(n + 2 * len(visits) + constant.shape[1], hidden.scale.size, 2)
    outputs = list(map(hidden.width_flags, range(len(visits))))
    inputs = list(map(hidden.pair_flags, ends)) or [dict.fromkeys(DIRECTIONS, False)] * m
    reasons = _sensor_actuator_reasons([*outputs, *inputs], modes)
    verdicts = [WidthIdentifiability(**flags, reasons=reasons) for flags in [*outputs, *inputs]]
    return SensorActuatorIdentifiability(verdicts[: len(visits)], verdicts[len(visits) :])


def _width_inputs(B: Floats, mode: Floats, drive: Drive) -> Floats:
    """Return -B chi of a mode (m): the effect of each input's [right, left] on x' (n x 2m)."""
    right = -drive.slope_right * (mode > 0)
    left = drive.slope_left * (mode < 0)
    return np.stack([B * right, B * left], axis=2).reshape(len(B), -1)


def _sensor_actuator_reasons(widths: list[dict[str, Any]], modes: Floats) -> tuple[str, ...]:
    """Describe why a centre is not identifiable, and the remedy; empty if all are."""
    if all(flags["centre"] for flags in widths):
        return ()
    silent = (modes == 0).any(axis=0).tolist() if len(modes) else []
    if not all(silent) or not silent:
        return (
            "the inverse never lets the actuator fall silent while the output is read, so a shift "
            "of its zone cannot be separated from one of the sensor's; coast: compensator.coast "
            "= 0.4",
        )
    return ("a shift of the zones cannot be separated from a shift of the state",)
