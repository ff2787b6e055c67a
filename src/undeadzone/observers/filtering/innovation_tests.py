"""Score statistics of assumptions: dependence of normalised innovations on a regressor.

A score that is too large rejects an assumption.

If all assumptions are true, innovations are white and depend on nothing that was known before them.
The sum of each, times a regressor, over the root of the sum of the regressor's squares is then a
normal number of variance 1. Sums fade. docs/innovation_tests.md lists the regressors.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import ASSUMPTION_CHECKS, Reading
from undeadzone.nonlinearities.sensor import present
from undeadzone.numerics.clip import clip

NOISY = 7.0  # square of the score of the size of innovations over `Doubt.most`, to refute the noise
STUCK = 0.01  # share of readings that stay while z^ moves on, likewise
FEWEST = 4.0  # how many of these there must be of late
ENOUGH = 10.0  # innovations from which a score is a normal number, however far one of them is
AGREE = 1 / 8  # share of an innovation within which two readings that are refused agree
ROW = 3.0  # readings in a row that are refused and agree, no silence: no glitches
OFTEN = 1.7  # such rows of late, from which readings and model do not go together
SPAN = 8.0  # ratio of the memory of a row to that of a score
FORETOLD = 3.0  # deviations beyond which a reading is unlike its prediction
NOTHING_KNOWN = 1e6  # score of a value that is not a number
MOST = 1e15  # of what an input shows in z [z]: a float holds its square
# Factor on a rejected assumption against others: any error makes innovations large.
SHARP = {"noise": 1 / 6, "sensor": 1.7, "dynamics": 1.2}

# Share of a score's square that multiplies variances: errors are absorbed in part.
WIDER = {"slope": 1.0, "dynamics": 1 / 9, "noise": 1 / 64}


class Scores(NamedTuple):
    """Fading sums for each output (p), and the data of the regressors.

    Attributes:
        size: of nu^2 - 1.
        count: half of its variance.
        lift, lift_square: of nu times what inputs of late show in z beyond their mean, and
            variance of that.
        rise, rise_square: of nu times how that changes, likewise.
        stuck: share of readings that stay though they were predicted to move.
        rest: the same times if they stay [z].
        row: how many readings in a row were refused and agreed.
        rows: how often it were `ROW`.
        last: reading before [y].
        same: readings in a row that equal the one before them.
        quick, brisk, slow: means of what inputs show in z, over the spans of `Doubt.means` [z].
    """

    size: Any
    count: Any
    lift: Any
    lift_square: Any
    rise: Any
    rise_square: Any
    stuck: Any
    rest: Any
    row: Any
    rows: Any
    last: Any
    same: Any
    quick: Any
    brisk: Any
    slow: Any


def start_scores(p: int) -> Scores:
    """Return the scores before any reading (p: number of outputs)."""
    return Scores(*[np.zeros(p)] * len(Scores._fields))


def update_scores(
    q: Any, s: Scores, e: Any, nu: Any, counted: Any, refused: Any, reading: Reading, u: Any
) -> Scores:
    """Return the scores after a further sample.

    A loop with more information than this filter feeds it into its input at once, which then
    predicts innovations although all assumptions are true. So inputs count by their means over a
    time in which the filter gets the same information.

    Args:
        q: the filter's numbers.
        s: the sums before it.
        e: innovations (p) [z].
        nu: the same over their deviations, 0 if none was used (p).
        counted: whether one counts (p).
        refused: whether a reading was refused (p).
        reading: the reading.
        u: the input from now on (m), which no score knows before the next sample.
    """
    doubt = q.doubt
    keep = q.doubt.keep
    far = ca.fabs(nu) > FORETOLD
    used = nu != 0
    nu = counted * nu
    y = ca.if_else(present(reading.y), reading.y, 0.0)
    follows = ca.logic_and(y != 0, ca.fabs(y - s.last) <= AGREE * ca.fabs(e * q.slope))
    row = ca.if_else(refused, ca.if_else(follows, s.row, 0.0) + 1, ca.if_else(used, 0.0, s.row))
    lift = counted * (s.brisk - s.slow)
    rise = counted * (s.quick - s.brisk)
    stays = ca.logic_and(ca.fabs(y - s.last) < doubt.stays, ca.fabs(y) > doubt.stays)
    same = ca.if_else(is_repeated(doubt, y, s.last), s.same + 1, 0.0)
    stays = ca.logic_and(stays, ca.logic_or(far, same > doubt.run))
    stays = ca.logic_and(stays, ca.fabs(reading.side) < 2)  # at a limit a sound sensor stays
    effect = clip(doubt.push @ u, -MOST, MOST)
    left = ca.vertsplit(ca.SX(doubt.means))
    before = (s.quick, s.brisk, s.slow)
    means = [effect + share * (mean - effect) for share, mean in zip(left, before, strict=True)]
    return Scores(
        keep * s.size + nu**2 - counted,
        keep**2 * s.count + counted,
        keep * s.lift + nu * lift,
        keep**2 * s.lift_square + lift**2,
        keep * s.rise + nu * rise,
        keep**2 * s.rise_square + rise**2,
        keep * s.stuck + (1 - keep) * stays,
        keep * s.rest + (1 - keep) * stays * ca.fmin(ca.fabs(y / q.slope), doubt.reach),
        row,
        (1 - (1 - keep) / SPAN) * s.rows + ca.logic_and(refused, row == ROW),
        y,
        same,
        *means,
    )


def is_repeated(doubt: Any, y: Any, last: Any) -> Any:
    """Return 1 if a reading repeats its predecessor, to the last digit, and counts as missing (p).

    A run of them shows a stuck sensor. Single ones come from a logger that polls too fast.
    """
    return ca.logic_and(y == last, doubt.noisy)


def score_squares(s: Scores) -> dict[str, Any]:
    """Return the squares of the normal scores by assumption, maximised over the outputs."""
    of_lift, of_rise = (ca.if_else(V > 0, V, 1.0) for V in (s.lift_square, s.rise_square))
    enough = ca.fmin(s.count / ENOUGH, 1.0)
    found = {
        "slope": s.lift**2 / of_lift,
        "dynamics": s.rise**2 / of_rise,
        "noise": ca.fmax(s.size, 0.0) ** 2 / (2 * ca.fmax(s.count, 1.0)),
    }
    return {name: ca.mmax(enough * square) for name, square in found.items()}


def stuck_ratio(doubt: Any, s: Scores) -> Any:
    """Return the statistic of unchanged readings over its limit (p) [1].

    Above 1 the sensor is faulty.
    """
    return s.stuck / ca.fmax(STUCK, FEWEST * (1 - doubt.keep))


def mismatch_ratio(s: Scores) -> Any:
    """Return the statistic of runs of rejected readings over its limit (1).

    Above 1 readings and model do not fit.
    """
    return ca.mmax(s.rows) / OFTEN


def stuck_level(doubt: Any, s: Scores) -> Any:
    """Return the mean abs(y) / m of a stuck sensor (p) [z], 0 if the sensor is sound."""
    return ca.if_else(stuck_ratio(doubt, s) > 1, s.rest / ca.fmax(s.stuck, STUCK), 0.0)


def assumption_ratios(doubt: Any, s: Scores) -> dict[str, Any]:
    """Return the test statistic of each assumption over its limit: above 1 it is rejected."""
    ratios = {"sensor": ca.fmax(ca.mmax(stuck_ratio(doubt, s)), mismatch_ratio(s))}
    for name, square in score_squares(s).items():
        ratios[name] = square / chance_limit(doubt, name)
    return ratios


def chance_limit(doubt: Any, name: str) -> Any:
    """Return the largest square of a score that counts as chance."""
    return NOISY * doubt.most if name == "noise" else doubt.limit


def excess_ratio(ratio: Any) -> Any:
    """Return the ratio if above 1, or 0 otherwise.

    A value that is not a number rejects the assumption, too.
    """
    return ca.if_else(ratio <= 1, 0.0, ca.if_else(ratio > 1, ratio, NOTHING_KNOWN))


def variance_factor(doubt: Any, s: Scores) -> Any:
    """Return the factor for variances after scores rejected assumptions (1), at least 1."""
    worst = 1.0
    each = assumption_ratios(doubt, s)
    for name, share in WIDER.items():
        worst = ca.fmax(worst, share * chance_limit(doubt, name) * excess_ratio(each[name]))
    return worst


def assumption_fields(ratios: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of an estimate about assumptions from their ratios.

    A ratio above 1 rejects.
    """
    bits = 0.0
    suspect = 0.0
    worst = 0.0
    for k, name in enumerate(ASSUMPTION_CHECKS):
        if name in ratios:
            ratio = excess_ratio(ratios[name])
            weight = SHARP.get(name, 1.0) * ratio
            ahead = weight > worst
            bits += 2.0**k * (ratio > 0)
            suspect = ca.if_else(ahead, k + 1.0, suspect)
            worst = ca.if_else(ahead, weight, worst)
    return {"consistent": bits == 0, "claims": bits, "suspect": suspect}
