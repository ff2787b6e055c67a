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
    WidthIdentifiability,
    describe_unreached_edges,
)
from undeadzone.linalg.matrices import Matrices
from undeadzone.nonlinearities.sensor import DIRECTIONS


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
