"""Identifiability of a play ahead of a dead zone: gaps and widths together (docs/play.md).

A reading on side s of the zone, in contact m of the play, is C_i x - chi_s d - chi_m c. The gaps
are states that never change, and each output stands twice, once for each contact, with the same d.
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
    Unobservable,
    WidthIdentifiability,
    describe_unreached_edges,
    unobservable_changes,
)
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import DIRECTIONS
from undeadzone.util.arrays import Floats


class WidthInformation(NamedTuple):
    """Information of readings on a single output.

    Attributes:
        zone: of its dead zone.
        gap: of its play: right and left gap, their sum and their difference.
        both: whether the sum of both centres, (c_r - c_l + d_r - d_l)/2, is identifiable.
        gap_std: deviation of c_r + c_l that an optimal estimator reaches [z].
    """

    zone: WidthIdentifiability
    gap: WidthIdentifiability
    both: bool
    gap_std: float


def append_gap_states(linear: Matrices, Ts: float | None) -> Matrices:
    """Return the plant with [c_r, c_l] of each output as states and each output twice, per
    contact.

    Args:
        linear: A, B, C of the plant, of one step if sampled.
        Ts: sample time [s] (None in continuous time).
    """
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    still = np.zeros((2 * p, 2 * p)) if Ts is None else np.eye(2 * p)
    A = np.block([[linear.A, np.zeros((n, 2 * p))], [np.zeros((2 * p, n)), still]])
    signs = np.diag(np.tile([-1.0, 1.0], p))
    C = np.hstack([np.repeat(linear.C, 2, axis=0), signs])
    return Matrices(A, pad_states(linear.B, 2 * p), C)


def separate_contacts(schedule: Schedule) -> Schedule:
    """Return the schedule of the outputs of `append_gap_states`: a branch counts in its contact
    alone.
    """
    assert schedule.contacts is not None
    sides = np.stack([schedule.sides * (schedule.contacts == m) for m in (1.0, -1.0)], axis=2)
    low, mean, high = np.repeat(schedule[5:8], 2, axis=1)
    return schedule._replace(
        sides=sides.reshape(len(sides), -1),
        low=low,
        mean=mean,
        high=high,
        levels=np.repeat(schedule.levels, 2, axis=0),
        exact=None,
        contacts=None,
        repeats=2,
    )


def gap_prior_rows(linear: Matrices, readings: ReadingConditions, least: float) -> Floats:
    """Return the prior information on `[x(0); c; d]` of `append_gap_states`.

    Gaps that are known have no error.

    Args:
        linear: of the plant.
        readings: the readings.
        least: deviation of exactly known values [z].
    """
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    prior = np.zeros((0, n + 2 * p)) if readings.prior is None else readings.prior
    gaps = np.eye(n + 4 * p)[n : n + 2 * p]
    known = gaps if readings.gaps_known else gaps[:0]
    return np.vstack([known / least, np.insert(prior, [n] * (2 * p), 0.0, axis=1)])


def _double_outputs(linear: Matrices, readings: ReadingConditions) -> ReadingConditions:
    """Return the readings with every output twice, without prior information."""
    p = linear.C.shape[0]
    bias = readings.bias
    colour = readings.colour
    arrive = np.ones(p) if readings.arrive is None else readings.arrive
    return readings._replace(
        noise=np.repeat(readings.noise, 2),
        arrive=np.repeat(arrive, 2),
        bias=None if bias is None else pad_states(bias, 2 * p),
        colour=None if colour is None else colour._replace(B=pad_states(colour.B, 2 * p)),
    )


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
    n = linear.A.shape[0]
    p = linear.C.shape[0]
    whole = append_gap_states(linear, schedule.Ts)
    twice = separate_contacts(schedule)
    swing = float((schedule.high - schedule.low).max())
    least = EXACT * max(float(schedule.levels.max()), EXACT * swing) or EXACT
    twofold = _double_outputs(linear, readings)
    prior = gap_prior_rows(linear, readings, least)
    hidden, visited = _hidden_changes(whole, twice, twofold, prior)
    unknowns = hidden.scale.size
    expected = optimal_deviations(whole, twice, twofold._replace(prior=prior))
    each = []
    for i in range(p):
        gap: dict[str, Any] = {
            name: hidden.is_combination_known(_gap_and_width_direction(unknowns, n, p, i, pair))
            for name, pair in DIRECTIONS.items()
        }
        zone = hidden.width_flags(i)
        both = hidden.is_combination_known(
            _gap_and_width_direction(unknowns, n, p, i, (1.0, -1.0), (1.0, -1.0))
        )
        own = slice(n + 2 * i, n + 2 * i + 2)
        gap_std = float(np.sqrt(expected.covariance[own, own].sum())) if gap["width"] else np.inf
        reasons = (
            *_unreached_behind_gap(schedule, n + 2 * p, i),
            *_single_contact_reason(schedule, visited, i),
            *_describe_asymmetries(zone, gap, both, readings.gaps_known),
        )
        of_zone = WidthIdentifiability(**zone, reasons=reasons, std=expected.widths[i])
        each.append(
            WidthInformation(of_zone, WidthIdentifiability(**gap, reasons=()), both, gap_std)
        )
    return each


def state_identifiability(
    linear: Matrices, schedule: Schedule, readings: ReadingConditions
) -> list[bool]:
    """Return whether the readings along a schedule determine each state (n).

    Arguments as of `gap_and_width_information`.
    """
    whole = append_gap_states(linear, schedule.Ts)
    twofold = _double_outputs(linear, readings)
    prior = gap_prior_rows(linear, readings, 1.0)
    hidden, _ = _hidden_changes(whole, separate_contacts(schedule), twofold, prior)
    return list(map(hidden.is_state_known, range(linear.A.shape[0])))


def _hidden_changes(
    whole: Matrices, twice: Schedule, twofold: ReadingConditions, prior: Floats
) -> tuple[Unobservable, np.ndarray]:
    """Return the changes that no reading shows, and the visited branches (2p x 2).

    Args:
        whole: with gaps as states.
        twice: the schedule with each output twice.
        twofold: the readings so.
        prior: of `gap_prior_rows`.
    """
    visited = twice.branch_visits(whole.A.shape[0])
    hidden = unobservable_changes(whole, visited, twice.Ts, twofold.bias, repeats=2)
    return hidden.exclude_known(prior), visited


def _gap_and_width_direction(
    size: int, n: int, p: int, i: int, gap: tuple[float, ...], zone: tuple[float, ...] = (0.0, 0.0)
) -> Floats:
    """Return a combination of gaps and widths of output i among `[x; c; d]`."""
    direction = np.zeros(size)
    direction[n + 2 * i : n + 2 * i + 2] = gap
    direction[n + 2 * p + 2 * i : n + 2 * p + 2 * i + 2] = zone
    return direction


def _unreached_behind_gap(schedule: Schedule, n: int, i: int) -> list[str]:
    """Describe why edges behind a gap are not visited."""
    words = []
    for reason in describe_unreached_edges(schedule, schedule.branch_visits(n), i):
        named = reason.replace("below d_r,", "below d_r + c_r,")
        words.append(named.replace("above -d_l,", "above -d_l - c_l,"))
    return words


def _single_contact_reason(schedule: Schedule, visited: np.ndarray, i: int) -> list[str]:
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
