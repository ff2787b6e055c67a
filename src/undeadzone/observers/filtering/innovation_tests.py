"""Score statistics of claims: what normalised innovations depend on if a claim is false.

If all claims are true, innovations are white and depend on nothing that was known before them. The
sum of each, times a regressor, over the root of the sum of the regressor's squares is then a normal
number of variance 1. Sums fade. docs/filters.md has the regressors and what they find.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import CLAIMS, Reading
from undeadzone.nonlinearities.sensor import present

NOISY = 7.0  # square of the score of the size of innovations over `Doubt.most`, to refute the noise
HELD = 0.01  # share of readings that stay where z^ moves on, likewise
FEWEST = 4.0  # how many of these there must be of late
ENOUGH = 10.0  # innovations from which a score is a normal number, however far one of them is
AGREE = 1 / 8  # share of an innovation within which two readings that are refused agree
ROW = 3.0  # readings in a row that are refused and agree, no silence: no glitches
OFTEN = 1.7  # such rows of late, from which readings and model do not go together
SPAN = 8.0  # for how much longer a row counts than what a score holds
FORETOLD = 3.0  # deviations beyond which a reading is not what was foretold
NOTHING_KNOWN = 1e6  # by how much what is no number refutes a claim
MOST = 1e15  # of what an input shows in z [z]: a float holds its square
# By how much a claim that is refuted goes before others: innovations are large whatever is false.
SHARP = {"noise": 1 / 6, "sensor": 1.7, "dynamics": 1.2}

# Share of the square of a score that multiplies variances: what is missed is absorbed in part.
WIDER = {"slope": 1.0, "dynamics": 1 / 9, "noise": 1 / 64}


class Scores(NamedTuple):
    """Fading sums for each output (p), and what the regressors need.

    Attributes:
        size: of nu^2 - 1.
        count: half of its variance.
        lift, lift_square: of nu times what inputs of late show in z beyond their mean, and
            variance of that.
        rise, rise_square: of nu times how that changes, likewise.
        held: share of readings that stay though they were foretold to move.
        rest: the same times where they stay [z].
        row: how many readings in a row were refused and agreed.
        rows: how often it were `ROW`.
        last: reading before [y].
        quick, brisk, slow: means of what inputs show in z, over the spans of `Doubt.means` [z].
    """

    size: Any
    count: Any
    lift: Any
    lift_square: Any
    rise: Any
    rise_square: Any
    held: Any
    rest: Any
    row: Any
    rows: Any
    last: Any
    quick: Any
    brisk: Any
    slow: Any


def start_scores(p: int) -> Scores:
    """Return before any reading; p: number of outputs."""
    return Scores(*[np.zeros(p)] * len(Scores._fields))


def update_scores(
    q: Any, s: Scores, e: Any, nu: Any, counted: Any, refused: Any, reading: Reading, u: Any
) -> Scores:
    """Return the sums after one more sample.

    A loop that sees more than this filter puts it into its input at once, where it foretells
    innovations though all claims are true. So inputs count by their means over a while, in which
    the filter saw it too.

    Args:
        q: the filter's numbers.
        s: the sums before it.
        e: innovations (p) [z].
        nu: the same over their deviations, 0 where none was used (p).
        counted: whether one counts (p).
        refused: whether a reading was refused (p).
        reading: what was read.
        u: the input from now on (m), which no score knows before the next sample.
    """
    doubt, keep = q.doubt, q.doubt.keep
    far, used, nu = ca.fabs(nu) > FORETOLD, nu != 0, counted * nu
    y = ca.if_else(present(reading.y), reading.y, 0.0)
    follows = ca.logic_and(y != 0, ca.fabs(y - s.last) <= AGREE * ca.fabs(e * q.slope))
    row = ca.if_else(refused, ca.if_else(follows, s.row, 0.0) + 1, ca.if_else(used, 0.0, s.row))
    lift, rise = counted * (s.brisk - s.slow), counted * (s.quick - s.brisk)
    stays = ca.logic_and(ca.fabs(y - s.last) < doubt.stays, ca.fabs(y) > doubt.stays)
    stays = ca.logic_and(stays, ca.logic_or(far, is_stuck(doubt, y, s.last)))
    stays = ca.logic_and(stays, ca.fabs(reading.side) < 2)  # at a limit a sound sensor stays
    shown = ca.fmax(ca.fmin(doubt.push @ u, MOST), -MOST)
    left, before = ca.vertsplit(ca.SX(doubt.means)), (s.quick, s.brisk, s.slow)
    means = [shown + share * (mean - shown) for share, mean in zip(left, before, strict=True)]
    return Scores(
        keep * s.size + nu**2 - counted,
        keep**2 * s.count + counted,
        keep * s.lift + nu * lift,
        keep**2 * s.lift_square + lift**2,
        keep * s.rise + nu * rise,
        keep**2 * s.rise_square + rise**2,
        keep * s.held + (1 - keep) * stays,
        keep * s.rest + (1 - keep) * stays * ca.fmin(ca.fabs(y / q.slope), doubt.reach),
        row,
        (1 - (1 - keep) / SPAN) * s.rows + ca.logic_and(refused, row == ROW),
        y,
        *means,
    )


def is_stuck(doubt: Any, y: Any, last: Any) -> Any:
    """Return whether a reading that is the one before to the last digit shows a stuck sensor
    (p).
    """
    return ca.logic_and(y == last, doubt.noisy)


def squares(s: Scores) -> dict[str, Any]:
    """Return squares of the scores that are normal numbers, by claim, the largest of the
    outputs.
    """
    of_lift, of_rise = (ca.if_else(V > 0, V, 1.0) for V in (s.lift_square, s.rise_square))
    enough = ca.fmin(s.count / ENOUGH, 1.0)
    found = {
        "slope": s.lift**2 / of_lift,
        "dynamics": s.rise**2 / of_rise,
        "noise": ca.fmax(s.size, 0.0) ** 2 / (2 * ca.fmax(s.count, 1.0)),
    }
    return {name: ca.mmax(enough * square) for name, square in found.items()}


def holding(doubt: Any, s: Scores) -> Any:
    """By how much readings that stay refute that the sensor is sound (p): above 1 they do."""
    return s.held / ca.fmax(HELD, FEWEST * (1 - doubt.keep))


def losing(s: Scores) -> Any:
    """By how much rows of refused readings refute that they and the model go together: above 1."""
    return ca.mmax(s.rows) / OFTEN


def resting(doubt: Any, s: Scores) -> Any:
    """Where readings stay (p) [z], 0 where the sensor is sound."""
    return ca.if_else(holding(doubt, s) > 1, s.rest / ca.fmax(s.held, HELD), 0.0)


def rejection_levels(doubt: Any, s: Scores) -> dict[str, Any]:
    """By how much each claim is refuted: above 1 it is."""
    ratios = {"sensor": ca.fmax(ca.mmax(holding(doubt, s)), losing(s))}
    for name, square in squares(s).items():
        ratios[name] = square / limit_of(doubt, name)
    return ratios


def limit_of(doubt: Any, name: str) -> Any:
    """Return square of a score that is taken for chance."""
    return NOISY * doubt.most if name == "noise" else doubt.limit


def beyond(ratio: Any) -> Any:
    """By how much a claim is refuted, 0 where it is not; what is no number refutes it, too."""
    return ca.if_else(ratio <= 1, 0.0, ca.if_else(ratio > 1, ratio, NOTHING_KNOWN))


def stretch(doubt: Any, s: Scores) -> Any:
    """By how much deviations are to be larger, squared, where a score refutes its claim."""
    worst, each = 1.0, rejection_levels(doubt, s)
    for name, share in WIDER.items():
        worst = ca.fmax(worst, share * limit_of(doubt, name) * beyond(each[name]))
    return worst


def verdict(ratios: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of an estimate about claims, by how much each is refuted: above 1 it is."""
    bits, suspect, worst = 0.0, 0.0, 0.0
    for k, name in enumerate(CLAIMS):
        if name in ratios:
            ratio = beyond(ratios[name])
            weight = SHARP.get(name, 1.0) * ratio
            ahead = weight > worst
            bits += 2.0**k * (ratio > 0)
            suspect = ca.if_else(ahead, k + 1.0, suspect)
            worst = ca.if_else(ahead, weight, worst)
    return {"consistent": bits == 0, "claims": bits, "suspect": suspect}
