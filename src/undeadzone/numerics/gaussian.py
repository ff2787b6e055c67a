"""Gaussian beliefs on CasADi expressions: predict, correct by a reading, truncate at a bound.

Readings that may be wrong, and silences that may be fake, are used by matching mean and covariance.
docs/filters.md derives the formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca

CLIP = 30.0  # standard deviations beyond which all readings are alike: all of them are wrong
TAIL = 10.0  # standard deviations over which a glitch is spread, besides its reach


class Gaussian(NamedTuple):
    """A normal distribution of N variables.

    Attributes:
        mean: (N).
        cov: covariance (N x N), symmetric.
    """

    mean: Any
    cov: Any


def triangle(cov: Any, entries: ca.Sparsity) -> Any:
    """The given entries of a symmetric matrix, of its upper triangle, column by column."""
    return ca.project(cov, entries).nz[:]


def symmetric(column: Any, entries: ca.Sparsity) -> Any:
    """The symmetric matrix whose `triangle` is given; outside these entries it is known to be 0."""
    return ca.triu2symm(ca.SX(entries, column))


def linearise(f: Callable[[Any], Any], at: Any) -> tuple[Any, Any]:
    """The value of f and its Jacobian at the column `at`."""
    X = ca.SX.sym("X", at.shape[0])
    value = f(X)
    value_at, jacobian = ca.substitute([value, ca.jacobian(value, X)], [X], [at])
    return value_at, jacobian


def predict(
    belief: Gaussian,
    change: Callable[[Any], Any],
    Q: Any,
    lasting: Any = 1.0,
    bend: Callable[[Any], tuple[Any, Any]] | None = None,
) -> Gaussian:
    """The belief after x+ = x + f(x) + w, to second order; exact for degree 2 and lasting = 1.

    Args:
        belief: of x (N).
        change: f, by which the model changes x.
        Q: covariance of w (N x N).
        lasting: steps for which the error of linearisation keeps its sign. It is not white, and
            counts that much more.
        bend: bend(x) = (G (N x M), b (M)) such that all that is nonlinear in f(x) is, nearly, in
            G b(x). With few b this is much cheaper. Default: G = I, b = f.
    """
    P, X = belief.cov, ca.SX.sym("X", belief.mean.shape[0])
    value = change(X)
    G, b = (ca.SX.eye(X.shape[0]), value) if bend is None else bend(X)
    nonlinear = ca.which_depends(b, X, 2, True)
    rows = [row for row, bends in enumerate(nonlinear) if bends]
    hessians = [ca.hessian(b[row], X)[0] for row in rows]
    expressions = [value, ca.jacobian(value, X), *hessians]
    moved, E, *curvatures = ca.substitute(expressions, [X], [belief.mean])
    products = [H @ P for H in curvatures]
    shift, excess = ca.SX(b.shape[0], 1), ca.SX(b.shape[0], b.shape[0])
    for row, M in zip(rows, products, strict=True):
        shift[row] = ca.trace(M) / 2
        for column, other in zip(rows, products, strict=True):
            excess[row, column] = lasting * ca.dot(M, other.T) / 2
    mean = belief.mean + (moved + G @ shift)
    return Gaussian(mean, spread(P, E, Q + G @ excess @ G.T))


def advance(belief: Gaussian, change: Callable[[Any], Any], Q: Any, E: Any = None) -> Gaussian:
    """The belief after x+ = x + f(x) + w, to first order.

    Args:
        belief: of x (N).
        change: f, by which the model changes x.
        Q: covariance of w (N x N).
        E: the Jacobian of f to take (N x N); default: that at the mean.
    """
    moved, slope = linearise(change, belief.mean) if E is None else (change(belief.mean), E)
    return Gaussian(belief.mean + moved, spread(belief.cov, slope, Q))


def spread(P: Any, E: Any, Q: Any) -> Any:
    """(I + E) P (I + E)' + Q as P and its increment.

    At fast sampling E is small: to add I first would round it, in single precision until the
    covariance is not positive any more.
    """
    gained = E @ P
    return from_upper(P + (gained + gained.T + gained @ E.T + Q))


def update(belief: Gaussian, h: Any, e: Any, R: Any, use: Any) -> tuple[Gaussian, Any]:
    """The belief after one reading h x + v, by Joseph's form.

    In that form rounding cannot make the covariance indefinite.

    Args:
        belief: of x (N).
        h: row of the reading (1 x N).
        e: innovation, the reading less what was expected; a number in any case.
        R: variance of v.
        use: 0 leaves the belief as it is, or the share by which each variable is moved (N).

    Returns:
        The belief, and the variance of the innovation.
    """
    mean, P = belief
    S = h @ P @ h.T + R
    K = use * (P @ h.T) / S
    half = P - K @ (h @ P)
    cov = half - (half @ h.T) @ K.T + R * (K @ K.T)
    return Gaussian(mean + K * e, from_upper(cov)), S


def truncate(
    belief: Gaussian, h: Any, excess: Any, R: Any, use: Any, limit: float
) -> tuple[Gaussian, Any]:
    """The belief given that excess + h (x - x^) + v <= 0, by matching mean and covariance.

    Args:
        belief: of x (N), with the mean x^.
        h: row of the bound (1 x N).
        excess: by which the mean lies beyond the bound.
        R: variance of v.
        use: 0 leaves the belief as it is.
        limit: a bound that holds with a probability of at least Phi(limit) is not used either.

    Returns:
        The belief, and 1 where the bound was used.
    """
    mean, P = belief
    std = ca.sqrt(h @ P @ h.T + R)
    alpha = -excess / std
    used = ca.logic_and(use, alpha < limit)
    ratio = ca.if_else(used, hazard(alpha), 0.0)
    along = P @ h.T / std
    cov = P - ratio * (ratio + alpha) * (along @ along.T)
    return Gaussian(mean - ratio * along, from_upper(cov)), used


def truncate_to(belief: Gaussian, i: int, low: Any, high: Any) -> tuple[Gaussian, Any]:
    """The belief given low <= x_i <= high, by matching mean and covariance.

    It is unchanged where the probability of that is below 1e-6.

    Returns:
        The belief, and the logarithm of that probability.
    """
    mean, P = belief
    std = ca.sqrt(P[i, i])
    a, b = (low - mean[i]) / std, (high - mean[i]) / std
    chance = (ca.erf(b / math.sqrt(2)) - ca.erf(a / math.sqrt(2))) / 2
    at_a, at_b = _density(a), _density(b)
    share = ca.if_else(chance > 1e-6, 1 / chance, 0.0)
    shift = (at_a - at_b) * share
    along = P[:, i] / std
    cov = P - (shift**2 + (b * at_b - a * at_a) * share) * (along @ along.T)
    return Gaussian(mean + shift * along, from_upper(cov)), ca.log(ca.fmax(chance, 1e-300))


def hazard(alpha: Any) -> Any:
    """phi(alpha) / Phi(alpha) of the standard normal distribution.

    Below -5 by its asymptotic series, 1e-4 accurate there.
    """
    near, far = ca.fmax(alpha, -5.0), ca.fmax(-alpha, 5.0)
    exact = ca.exp(-(near**2) / 2) / (math.sqrt(math.pi / 2) * (1 + ca.erf(near / math.sqrt(2))))
    return ca.if_else(alpha > -5.0, exact, far + (1 - (2 - 10 / far**2) / far**2) / far)


def log_chance(alpha: Any) -> Any:
    """log Phi(alpha) of the standard normal distribution; below -5 by its asymptote."""
    near, far = ca.fmax(alpha, -5.0), ca.fmax(-alpha, 5.0)
    exact = ca.log((1 + ca.erf(near / math.sqrt(2))) / 2)
    series = ca.log(1 - (1 - 3 / far**2) / far**2)
    asymptote = -(far**2) / 2 - ca.log(far) - math.log(2 * math.pi) / 2 + series
    return ca.if_else(alpha > -5.0, exact, asymptote)


def _density(x: Any) -> Any:
    """phi(x) of the standard normal distribution."""
    return ca.exp(-(x**2) / 2) / math.sqrt(2 * math.pi)


def from_upper(cov: Any) -> Any:
    """The symmetric matrix with this upper triangle."""
    return ca.triu2symm(ca.triu(cov))


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
