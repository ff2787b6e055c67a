"""Score statistics of claims: what normalised innovations depend on if a claim is false.

If all claims are true, innovations are white and depend on nothing that was known before them. The
sum of each, times a regressor, over the root of the sum of the regressor's squares is then a normal
number of variance 1. Sums fade. docs/filters.md has the regressors and what they find.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.ends.sensor import present
from undeadzone.interfaces import CLAIMS, Reading

LIMIT = 3.2  # standard deviations of a score from which its claim is refuted
NOISY = 4.0  # the same of the size of innovations, one-sided
HELD = 0.01  # share of readings that stay where z^ moves on, likewise
FORETOLD = 3.0  # deviations beyond which a reading is not what was foretold
MOST = 1e100  # of what an input shows in z: its square is finite
# By how much a claim that is refuted goes before others: innovations are large whatever is false.
SHARP = {"noise": 1 / 6, "sensor": 1.7, "dynamics": 1.2}


class Scores(NamedTuple):
    """Fading sums for each output (p), and what the regressors need.

    Attributes:
        mean, side: of nu, and of nu times the side of the reading.
        size: of nu^2 - 1.
        count: variance of `mean` and `side`, half of that of `size`.
        lift, lift_square: of nu times what the last input shows in z beyond its mean of late, and
            variance of that.
        rise, rise_square: of nu times what the last change of the input shows, likewise.
        held: share of readings that stay though they were foretold to move.
        last: reading before [y].
        input, level: what the last input shows in z, and its mean of late [z].
        change: of `input`, at the last sample [z].
    """

    mean: Any
    side: Any
    size: Any
    count: Any
    lift: Any
    lift_square: Any
    rise: Any
    rise_square: Any
    held: Any
    last: Any
    input: Any
    level: Any
    change: Any


def unscored(p: int) -> Scores:
    """Before any reading; p: number of outputs."""
    return Scores(*[np.zeros(p)] * len(Scores._fields))


def scored(
    doubt: Any, s: Scores, nu: Any, counted: Any, far: Any, reading: Reading, u: Any
) -> Scores:
    """The sums after one more sample.

    Args:
        doubt: numbers of the doubt, `Doubt`.
        s: the sums before it.
        nu: normalised innovations, 0 where none counts (p).
        counted: whether one counts (p).
        far: whether a reading is not what was foretold (p).
        reading: what was read.
        u: the input from now on (m), which no score knows before the next sample.
    """
    keep = doubt.keep
    y = ca.if_else(present(reading.y), reading.y, 0.0)
    lift, rise = counted * (s.input - s.level), counted * s.change
    stays = ca.logic_and(ca.fabs(y - s.last) < doubt.stays, ca.fabs(y) > doubt.stays)
    stays = ca.logic_and(stays, ca.logic_or(far, y == s.last))
    shown = ca.fmax(ca.fmin(doubt.push @ u, MOST), -MOST)
    return Scores(
        mean=keep * s.mean + nu,
        side=keep * s.side + nu * ca.sign(y),
        size=keep * s.size + nu**2 - counted,
        count=keep**2 * s.count + counted,
        lift=keep * s.lift + nu * lift,
        lift_square=keep**2 * s.lift_square + lift**2,
        rise=keep * s.rise + nu * rise,
        rise_square=keep**2 * s.rise_square + rise**2,
        held=keep * s.held + (1 - keep) * stays,
        last=y,
        input=shown,
        level=doubt.fade * s.level + (1 - doubt.fade) * shown,
        change=shown - s.input,
    )


def squares(s: Scores) -> dict[str, Any]:
    """Squares of the scores that are normal numbers, by claim, the largest of the outputs."""
    least = 1e-300
    both = ca.fmax(s.count, least)
    found = {
        "bias": s.mean**2 / both,
        "width": s.side**2 / both,
        "slope": s.lift**2 / ca.fmax(s.lift_square, least),
        "dynamics": s.rise**2 / ca.fmax(s.rise_square, least),
        "noise": ca.fmax(s.size, 0.0) ** 2 / (2 * both),
    }
    return {name: ca.mmax(square) for name, square in found.items()}


def refuted(s: Scores) -> dict[str, Any]:
    """By how much each claim is refuted: above 1 it is."""
    ratios = {}
    for name, square in squares(s).items():
        ratios[name] = square / (NOISY if name == "noise" else LIMIT) ** 2
    return ratios | {"sensor": ca.mmax(s.held) / HELD}


def stretch(s: Scores) -> Any:
    """By how much deviations are to be larger, squared, where a score refutes its claim."""
    worst = 1.0
    for square in (square for name, square in squares(s).items() if name != "noise"):
        worst = ca.fmax(worst, ca.if_else(square > LIMIT**2, square / 4, 1.0))
    return worst


def as_bits(ratios: dict[str, Any]) -> tuple[Any, Any]:
    """(bits of the refuted claims, number of the one that is likeliest false; 0: none is).

    Args:
        ratios: by how much each is refuted, by name.
    """
    bits, suspect, worst = 0.0, 0.0, 0.0
    for k, name in enumerate(CLAIMS):
        if name in ratios:
            false = ratios[name] > 1
            weight = ca.if_else(false, 1 + SHARP.get(name, 1.0) * ratios[name], 0.0)
            bits += 2.0**k * false
            suspect = ca.if_else(weight > worst, k + 1.0, suspect)
            worst = ca.fmax(worst, weight)
    return bits, suspect
