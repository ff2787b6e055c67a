"""Identifiability of a sensor's dead zone together with a second element's numbers.

With a play ahead of it (docs/play.md) a reading on side s of the zone, in contact m of the play, is
C_i x - chi_s d - chi_m c. The gaps are states that never change, and each output stands twice, once
for each contact, with the same d.

With a dead zone of the actuator and b = `[b_r; b_l]` of every input among the unknowns, a change
(v, c, b) stays invisible if A v - B chi_j b lies in U for each mode j that the actuator visits,
chi = (m_r, 0) on the right, (0, -m_l) on the left, 0 if it is silent (docs/actuator.md has the
proof).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from undeadzone.analysis.branch_schedule import Schedule
from undeadzone.analysis.identifiability.information import (
    EXACT,
    ReadingConditions,
    optimal_deviations,
    pad_states,
)
from undeadzone.analysis.identifiability.linear import (
    WidthIdentifiability,
    describe_unreached_edges,
    unobservable_changes,
)
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.actuator import Drive, through_zone
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats

# --- A play ahead of the zone


class WidthInformation(NamedTuple):
    """Information of readings on a single output.

    Attributes:
        zone: of its dead zone.
        gap: whether right and left gap of its play, their sum and their difference are
            identifiable, by name.
        both: whether the sum of both centres, (c_r - c_l + d_r - d_l)/2, is identifiable.
        gap_std: deviation of c_r + c_l that an optimal estimator reaches [z].
    """

    zone: WidthIdentifiability
    gap: dict[str, Any]
    both: bool
    gap_std: float


def append_gaps(
    linear: Matrices, schedule: Schedule, readings: ReadingConditions
) -> tuple[Matrices, Schedule, ReadingConditions]:
    """Return plant, schedule and readings with [c_r, c_l] of each output as states.

    Each output stands twice, once per contact, and a branch counts in its contact alone. Gaps that
    are known have no error.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        schedule: of the sides and contacts.
        readings: the readings.
    """
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    gaps = 2 * p
    still = np.zeros((gaps, gaps)) if schedule.Ts is None else np.eye(gaps)
    A = np.block([[linear.A, np.zeros((n, gaps))], [np.zeros((gaps, n)), still]])
    signs = np.diag(np.tile([-1.0, 1.0], p))
    C = np.hstack([np.repeat(linear.C, 2, axis=0), signs])
    assert schedule.contacts is not None
    sides = np.stack([schedule.sides * (schedule.contacts == m) for m in (1.0, -1.0)], axis=2)
    low, mean, high = np.repeat(schedule[5:8], 2, axis=1)
    twice = schedule._replace(
        sides=sides.reshape(len(sides), -1),
        low=low,
        mean=mean,
        high=high,
        levels=np.repeat(schedule.levels, 2, axis=0),
        exact=None,
        contacts=None,
        repeats=2,
    )
    swing = float((schedule.high - schedule.low).max())
    least = EXACT * max(float(schedule.levels.max()), EXACT * swing) or EXACT
    prior = np.zeros((0, n + gaps)) if readings.prior is None else readings.prior
    known = np.eye(n + 2 * gaps)[n : n + gaps if readings.gaps_known else n]
    bias = readings.bias
    colour = readings.colour
    twofold = readings._replace(
        noise=np.repeat(readings.noise, 2),
        arrive=None if readings.arrive is None else np.repeat(readings.arrive, 2),
        bias=None if bias is None else pad_states(bias, gaps),
        colour=None if colour is None else colour._replace(B=pad_states(colour.B, gaps)),
        prior=np.vstack([known / least, np.insert(prior, [n] * gaps, 0.0, axis=1)]),
    )
    return Matrices(A, pad_states(linear.B, gaps), C), twice, twofold


def gap_and_width_information(
    linear: Matrices, schedule: Schedule, readings: ReadingConditions
) -> list[WidthInformation]:
    """Return the information of the readings along a schedule on gaps and widths of each
    output.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        schedule: of the sides and contacts.
        readings: the readings.
    """
    n, p = linear.B.shape[0], linear.C.shape[0]
    whole, twice, twofold = append_gaps(linear, schedule, readings)
    expected = optimal_deviations(whole, twice, twofold)
    hidden = expected.hidden
    read = twice.branch_visits(n + 2 * p)
    reached = schedule.branch_visits(n + 2 * p)
    each = []
    for i in range(p):
        first = n + 2 * i
        gap = hidden.pair_flags(first)
        zone = hidden.width_flags(i)
        both = hidden.is_pair_known(dict.fromkeys((first, hidden.n + 2 * i), DIRECTIONS["centre"]))
        own = slice(first, first + 2)
        gap_std = float(np.sqrt(expected.covariance[own, own].sum())) if gap["width"] else np.inf
        reasons = (
            *describe_unreached_edges(schedule, reached, i),
            *_single_contact_reason(read, i),
            *_describe_asymmetries(zone, gap, both, readings.gaps_known),
        )
        of_zone = WidthIdentifiability(**zone, reasons=reasons, std=expected.widths[i])
        each.append(WidthInformation(of_zone, gap, both, gap_std))
    return each


def _single_contact_reason(visited: np.ndarray, i: int) -> list[str]:
    """Describe that output i is read in a single contact beyond its edges."""
    right, left = map(np.any, visited[2 * i : 2 * i + 2])
    if right == left:
        return []
    seen, other = ("right", "left") if right else ("left", "right")
    return [
        f"beyond the edges the output is read while it moves {seen} alone, never while it moves "
        f"{other}: the gap cannot be known"
    ]


def _describe_asymmetries(
    zone: dict[str, bool], gap: dict[str, bool], both: bool, gaps_known: bool
) -> list[str]:
    """Describe which asymmetries are identifiable, empty if every width is."""
    if (zone["right"] and zone["left"]) or gaps_known:
        return []
    if not (zone["width"] and gap["width"]):
        return []
    if both:
        return [
            "known are c_r + c_l, d_r + d_l and c_r - c_l + d_r - d_l: a shift of the gap cannot "
            "be separated from one of the zone, and z needs their sum alone"
        ]
    return [
        "known are c_r + c_l and d_r + d_l: the sum of both centres cannot be separated from a "
        "shift of "
        "the state"
    ]


# --- A dead zone of the actuator


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
