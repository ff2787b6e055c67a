"""Readings that may be wrong, and silences that may be fake, by matching mean and covariance.

docs/filters.md derives the formulas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.gaussian import Gaussian, from_upper, hazard, log_chance

CLIP = 30.0  # standard deviations beyond which all readings are alike: all of them are wrong
TAIL = 10.0  # standard deviations over which a glitch is spread, besides its reach


class Weighed(NamedTuple):
    """What is known after a reading, or a silence, that may be wrong.

    Attributes:
        belief: mean and covariance of the mixture of both cases.
        e: innovation, at most `CLIP` standard deviations; 0 of a silence.
        std: standard deviation of what was foretold.
        trust: probability that it is not wrong; 1 where it was not used.
        log: log of the density, or of the chance, with which it was foretold; 0 where not used.
    """

    belief: Gaussian
    e: Any
    std: Any
    trust: Any
    log: Any


def update_unless_glitch(
    belief: Gaussian,
    h: Any,
    e: Any,
    R: Any,
    use: Any,
    odds: Any,
    reach: Any,
    moved: Any = None,
    surprise: Any = 0.0,
) -> Weighed:
    """The belief after one reading h x + v that may be a glitch, by matching mean and covariance.

    A glitch says nothing of x and is evenly spread.

    Args:
        belief: of x (N).
        h: row of the reading (1 x N).
        e: innovation, the reading less what was expected.
        R: variance of v.
        use: 0 leaves the belief as it is.
        odds: log of the odds of a glitch before the reading is seen; None: none is one.
        reach: range over which a glitch is spread, besides `TAIL` standard deviations.
        moved: share by which the reading moves each variable (N); None: all move. What it says of
            the others is then known given those that stay.
        surprise: log of what else speaks for a regular reading (0) or against it (below).
    """
    P = belief.cov
    S = ca.fmax(h @ P @ h.T, 0.0) + R
    return settle(belief, P @ h.T / S, e, S, R, use, odds, reach, moved, surprise)


def settle(
    belief: Gaussian,
    K: Any,
    e: Any,
    S: Any,
    R: Any,
    use: Any,
    odds: Any,
    reach: Any,
    moved: Any = None,
    surprise: Any = 0.0,
) -> Weighed:
    """The belief after a reading of which the gain is known, or after a glitch.

    The covariance loses one product k k', which rounds each entry once and leaves it as it is where
    nothing is used; no variance falls below that of v seen through the gain, which it cannot in
    exact numbers.

    Args:
        belief: of x (N).
        K: gain of the regular update (N), the best one.
        e: innovation.
        S: variance of the innovation.
        R: variance of v.
        use, odds, reach, moved, surprise: as `update_unless_glitch` takes them.
    """
    std = ca.sqrt(S)
    if odds is None:
        return Weighed(_moved(belief, K, e, S, 0.0, R, use), e, std, ca.SX(1.0), 0.0)
    r = ca.fmax(ca.fmin(e / std, CLIP), -CLIP)
    near = r * std
    wrong = odds - ca.log(reach + TAIL * std)
    right = surprise - (r**2) / 2 - ca.log(2 * math.pi * S) / 2
    trust = 1 / (1 + ca.exp(ca.fmin(wrong - right, 700.0)))
    weight = ca.if_else(use, trust, 0.0)
    after = _moved(belief, K, near, S, (1 - weight) * near**2, R, weight, moved)
    log = ca.if_else(use, log_of_sum(right, wrong), 0.0)
    return Weighed(after, near, std, ca.if_else(use, trust, 1.0), log)


def _moved(
    belief: Gaussian, K: Any, e: Any, S: Any, between: Any, R: Any, weight: Any, moved: Any = None
) -> Gaussian:
    """The belief moved by a share of K e.

    Args:
        belief: of x (N).
        K: gain (N).
        e: innovation.
        S: what the covariance loses along K, per share.
        between: what it gains along the way that the mean moves, per share.
        R: variance of v.
        weight: the share.
        moved: as `update_unless_glitch` takes it.
    """
    mean, P = belief
    shift = K if moved is None else moved * K
    if moved is None:
        cov = P - (weight * (S - between) * K) @ K.T
    else:
        cov = P - lost_given(K, shift, weight * S, weight * between)
    least = weight * R * shift**2
    cov += ca.diag(ca.fmax(least - ca.diag(cov), 0.0))
    return Gaussian(mean + weight * e * shift, from_upper(cov))


def lost_given(along: Any, shift: Any, certain: Any, between: Any) -> Any:
    """What a covariance loses: certain (g g' - (g - s) (g - s)') - between s s'.

    Args:
        along: g, along which a bound or a reading would move the mean (N).
        shift: s, along which it does (N).
        certain: by how much the covariance is less where it is right.
        between: by how much it is more, as it may be wrong.
    """
    half = shift @ (certain * along - (certain + between) / 2 * shift).T
    return half + half.T


def together(readings: Sequence[Weighed]) -> Weighed:
    """What is known after readings that were taken one after the other, as columns."""
    return Weighed(
        belief=readings[-1].belief,
        e=ca.vertcat(*(one.e for one in readings)),
        std=ca.vertcat(*(one.std for one in readings)),
        trust=ca.vertcat(*(one.trust for one in readings)),
        log=sum(one.log for one in readings),
    )


def truncate_unless_fake(
    belief: Gaussian,
    h: Any,
    excess: Any,
    R: Any,
    use: Any,
    limit: float,
    fake: Any,
    moved: Any = None,
) -> tuple[Weighed, Any, Any]:
    """The belief given that excess + h (x - x^) + v <= 0, or that this silence is fake.

    Mean and covariance of the mixture are matched.

    Args:
        belief, h, excess, R, use, limit: as `truncate` takes them.
        fake: log of the probability that a silence is fake.
        moved: share by which the bound moves each variable (N); None: all move. What it says of
            the others is then known given those that stay.

    Returns:
        What is known, 1 where the bound was used, and the probability that the silence is no fake,
        used or not.
    """
    mean, P = belief
    std = ca.sqrt(ca.fmax(h @ P @ h.T, 0.0) + R)
    alpha = ca.fmax(-excess / std, -CLIP)
    used = ca.logic_and(use, alpha < limit)
    chance = log_chance(alpha)
    trust = 1 / (1 + ca.exp(ca.fmin(fake - chance, 700.0)))
    ratio = ca.if_else(used, hazard(alpha), 0.0)
    along = P @ h.T / std
    certain, between = trust * ratio * (ratio + alpha), trust * (1 - trust) * ratio**2
    if moved is None:
        shift, lost = along, (certain - between) * (along @ along.T)
    else:
        shift = moved * along
        lost = lost_given(along, shift, certain, between)
    after = Gaussian(mean - trust * ratio * shift, from_upper(P - lost))
    log = ca.if_else(used, log_of_sum(chance, fake), 0.0)
    return Weighed(after, 0.0, std, ca.if_else(used, trust, 1.0), log), used, trust


def log_of_sum(a: Any, b: Any) -> Any:
    """log(e^a + e^b)."""
    return ca.fmax(a, b) + ca.log(1 + ca.exp(-ca.fabs(a - b)))
