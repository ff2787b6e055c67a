"""Gaussian state estimates on CasADi expressions: prediction, measurement update, truncation at a
bound.

Readings that may be wrong, and silences that may be fake, are used by matching mean and covariance.
docs/filter_equations.md derives the formulas.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.clip import clip

CLIP = 30.0  # standard deviations beyond which all readings are alike: all of them are wrong
DEEP = 5.0  # standard deviations below which probabilities follow their asymptotes
NARROW = 1e-6  # least chance of an interval, over that of its nearer end
UNLIKELY = 0.01  # probability of an assumed range below which the range is not used
TAIL = 10.0  # standard deviations over which a glitch is spread, besides its reach


class Gaussian(NamedTuple):
    """Normal distribution of N variables.

    Attributes:
        mean: (N).
        cov: covariance (N x N), symmetric.
    """

    mean: Any
    cov: Any


def to_upper_entries(cov: Any, entries: ca.Sparsity) -> Any:
    """Return the given entries of a symmetric matrix, of its upper triangle, column by column."""
    return ca.project(cov, entries).nz[:]


def from_upper_entries(column: Any, entries: ca.Sparsity) -> Any:
    """Return the symmetric matrix with the given `to_upper_entries`, 0 elsewhere."""
    return ca.triu2symm(ca.SX(entries, column))


def linearise(f: Callable[[Any], Any], at: Any) -> tuple[Any, Any]:
    """Return the value of f and its Jacobian at the column `at`."""
    X = ca.SX.sym("X", at.shape[0])
    value = f(X)
    options = [{"helper_options": {"ad_weight": weight}} for weight in (0.0, 1.0)]
    slopes = [ca.jacobian(value, X, option) for option in options]  # forward, and backward
    value_at, jacobian = ca.substitute([value, min(slopes, key=ca.n_nodes)], [X], [at])
    return value_at, jacobian


class Products(NamedTuple):
    """Function G Z (l r) of x whose l and r (C) are linear in x, and multiplied entry by
    entry.

    Attributes:
        G: its first rows (at most N x M), the others are 0.
        Z: which products each of the M rows sums up (M x C).
        left, right: l and r.
    """

    G: Any
    Z: Any
    left: Any
    right: Any


def predict(
    belief: Gaussian,
    change: Callable[[Any], Any],
    Q: Any,
    lasting: Any = 1.0,
    bend: Callable[[Any], Products] | None = None,
) -> Gaussian:
    """Predict the state estimate for x+ = x + f(x) + w to second order.

    The result is exact for degree 2 and lasting = 1.

    Args:
        belief: of x (N).
        change: f, by which the model changes x.
        Q: covariance of w (N x N).
        lasting: steps for which the error of linearisation keeps its sign. It is not white, and
            counts that much more.
        bend: bend(x) is nearly all nonlinear terms of f(x) (much cheaper than to bend f itself,
            which is the default).
    """
    moved, E = linearise(change, belief.mean)
    X = ca.SX.sym("X", belief.mean.shape[0])
    if bend is None:
        G = ca.SX.eye(X.shape[0])
        (shift, excess) = second_order_terms(belief, change(X), X)
    else:
        G = bend(X).G
        (shift, excess) = product_terms(belief.cov, bend(X), X)
        G = ca.vertcat(G, ca.SX(X.shape[0] - G.shape[0], G.shape[1]))
    mean = belief.mean + (moved + G @ shift)
    return Gaussian(mean, propagate_covariance(belief.cov, E, Q + G @ (lasting * excess) @ G.T))


def second_order_terms(belief: Gaussian, b: Any, X: Any) -> tuple[Any, Any]:
    """Return the effect of the second derivatives of b(X) on its mean and first-order
    covariance.
    """
    rows = [row for row, bends in enumerate(ca.which_depends(b, X, 2, True)) if bends]
    hessians = ca.substitute([ca.hessian(b[row], X)[0] for row in rows], [X], [belief.mean])
    products = [H @ belief.cov for H in hessians]
    shift = ca.SX(b.shape[0], 1)
    excess = ca.SX(b.shape[0], b.shape[0])
    for row, M in zip(rows, products, strict=True):
        shift[row] = ca.trace(M) / 2
        for column, other in zip(rows, products, strict=True):
            excess[row, column] = ca.dot(M, other.T) / 2
    return shift, excess


def product_terms(P: Any, of: Products, X: Any) -> tuple[Any, Any]:
    """Return the second-order terms of Z (l r), which has no further derivatives, given the
    covariance P of X.
    """
    left = ca.jacobian(of.left, X)
    right = ca.jacobian(of.right, X)
    across = left @ P @ right.T
    each = mirror_upper((left @ P @ left.T) * (right @ P @ right.T) + across * across.T)
    return of.Z @ ca.diag(across), of.Z @ each @ of.Z.T


def predict_first_order(
    belief: Gaussian, change: Callable[[Any], Any], Q: Any, E: Any = None
) -> Gaussian:
    """Predict the state estimate for x+ = x + f(x) + w to first order.

    Args:
        belief: of x (N).
        change: f, by which the model changes x.
        Q: covariance of w (N x N).
        E: the Jacobian of f to take (N x N) (default: that at the mean).
    """
    moved, slope = linearise(change, belief.mean) if E is None else (change(belief.mean), E)
    return Gaussian(belief.mean + moved, propagate_covariance(belief.cov, slope, Q))


def propagate_covariance(P: Any, E: Any, Q: Any) -> Any:
    """Return (I + E) P (I + E)' + Q, computed as P and its increment (N x N).

    At fast sampling E is small: to add I first would round it, in single precision until the
    covariance is not positive any more.
    """
    gained = E @ P
    return mirror_upper(P + (gained + gained.T + gained @ E.T + Q))


def joseph_update(belief: Gaussian, h: Any, e: Any, R: Any, use: Any) -> tuple[Gaussian, Any]:
    """Return the state estimate after a scalar measurement h x + v, by Joseph's form.

    In that form rounding cannot make the covariance indefinite.

    Args:
        belief: of x (N).
        h: row of the reading (1 x N).
        e: innovation, the reading less its prediction (never NaN).
        R: variance of v.
        use: 0 leaves the belief as it is, or the share by which each variable is moved (N).

    Returns:
        The belief, and the variance of the innovation.
    """
    mean, P = belief
    along = P @ h.T
    S = h @ along + R
    K = use * along / S
    half = P - K @ along.T
    cov = half - (half @ h.T - R * K) @ K.T
    return Gaussian(mean + K * e, mirror_upper(cov)), S


def mix_gaussians(shares: Sequence[Any], beliefs: Sequence[Gaussian]) -> Gaussian:
    """Return the mean and the covariance of a mixture.

    Args:
        shares: of each belief. Their sum is 1.
        beliefs: about the same variables (N).
    """
    mean = sum(share * one.mean for share, one in zip(shares, beliefs, strict=True))
    cov = ca.SX(*beliefs[0].cov.shape)
    for share, one in zip(shares, beliefs, strict=True):
        off = one.mean - mean
        cov += share * one.cov + (share * off) @ off.T
    return Gaussian(mean, mirror_upper(cov))


def truncate_to_range(mean: Any, variance: Any, low: Any, high: Any) -> tuple[Any, Any, Any]:
    """Return the effect of the condition low <= x <= high, by matching mean and variance.

    Nothing changes if the probability of the condition is below `UNLIKELY`.

    Returns:
        By how much a mean moves along its covariance with x, by how much a covariance is less along
        the same, and that probability.
    """
    scale = ca.sqrt(0.5 / variance)
    a = (low - mean) * scale
    b = (high - mean) * scale
    twice = ca.erf(b) - ca.erf(a)  # the chance
    at_a = ca.exp(-(a**2))
    at_b = ca.exp(-(b**2))
    least = 2 * UNLIKELY
    share = (twice > least) * (2 / math.sqrt(math.pi) * scale / ca.fmax(twice, least))
    shift = (at_a - at_b) * share
    return shift, shift**2 + (b * at_b - a * at_a) * (2 * scale * share), twice / 2


def normal_cdf_and_hazard(alpha: Any) -> tuple[Any, Any]:
    """Return Phi(alpha) of the standard normal distribution and its hazard phi(alpha) /
    Phi(alpha).

    Below -5 by the asymptotic series of the hazard, 1e-4 accurate there.
    """
    here = normal_density(alpha)
    inside = _normal_cdf_limited(alpha)
    far = ca.fmax(-alpha, DEEP)
    series = far + (1 - (2 - 10 / far**2) / far**2) / far
    ratio = ca.if_else(alpha > -DEEP, here / inside, series)
    return ca.if_else(alpha > -DEEP, inside, here / series), ratio


def _normal_cdf_limited(alpha: Any) -> Any:
    """Return Phi(alpha) of the standard normal distribution, constant below -5."""
    return normal_cdf(ca.fmax(alpha, -DEEP))


def normal_cdf(x: Any) -> Any:
    """Return Phi(x) of the standard normal distribution, accurate to the rounding of 1: 0 far
    below.
    """
    return (1 + ca.erf(x / math.sqrt(2))) / 2


def normal_density(x: Any) -> Any:
    """Return phi(x) of the standard normal distribution."""
    return ca.exp(-0.5 * x**2) * (1 / math.sqrt(2 * math.pi))


def mirror_upper(cov: Any) -> Any:
    """Return the symmetric matrix with the upper triangle of a matrix."""
    return ca.triu2symm(ca.triu(cov))


class RobustUpdate(NamedTuple):
    """Result of a measurement update, or of a censored sample, that may be an outlier.

    Attributes:
        belief: mean and covariance of the mixture of both cases.
        e: innovation, at most `CLIP` standard deviations (0 for a censored sample).
        std: standard deviation of the predicted reading.
        trust: probability that it is not wrong (1 if it was not used).
        likely: predictive density, or probability, of the reading (1 if it was not used).
        gain: by which an innovation moved the mean (N), with its trust.
    """

    belief: Gaussian
    e: Any
    std: Any
    trust: Any
    likely: Any
    gain: Any


def update_with_outliers(
    belief: Gaussian,
    h: Any,
    e: Any,
    R: Any,
    use: Any,
    odds: Any,
    reach: Any,
    moved: Any = None,
    surprise: Any = 0.0,
) -> RobustUpdate:
    """Update a state estimate by a scalar measurement h x + v that may be an outlier.

    Mean and covariance of the mixture of both cases are matched.

    A glitch contains no information on x and is uniformly distributed.

    Args:
        belief: of x (N).
        h: row of the reading (1 x N).
        e: innovation, the reading less its prediction.
        R: variance of v.
        use: 0 leaves the belief as it is.
        odds: log of the prior odds of a glitch before the reading is seen (None: no reading is a
            glitch).
        reach: range over which a glitch is spread, besides `TAIL` standard deviations.
        moved: share by which the reading moves each variable (N) (None: all move). The information
            on the moved variables is then conditional on those that stay.
        surprise: log of further evidence for a regular reading (0) or against it (below 0).
    """
    P = belief.cov
    S = ca.fmax(h @ P @ h.T, 0.0) + R
    return update_with_gain(belief, P @ h.T / S, e, S, R, use, odds, reach, moved, surprise)


def update_with_gain(
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
) -> RobustUpdate:
    """Update a state estimate by a measurement of known gain that may be an outlier.

    The covariance loses one product k k' with k = sqrt(S) K, which rounds each entry once and
    leaves it unchanged if nothing is used. A variance stays at least K^2 R, as in exact arithmetic.

    Args:
        belief: of x (N).
        K: gain of the regular update (N), the best one.
        e: innovation.
        S: variance of the innovation.
        R: variance of the measurement's noise v.
        use, odds, reach, moved, surprise: see `update_with_outliers`; odds is the logarithm of
            the prior odds of an outlier (None: there are none).

    Returns:
        The updated belief, the clipped innovation, its deviation, the probability that the
        measurement is regular, its predicted density, and the gain that was used.
    """
    std = ca.sqrt(S)
    shift = K if moved is None else moved * K
    if odds is None:
        after = _shift_estimate(belief, K, e, S, 0.0, R, use, shift)
        return RobustUpdate(after, e, std, ca.SX(1.0), 1.0, use * shift)
    r = clip(e / std, -CLIP, CLIP)
    near = r * std
    wrong = ca.exp(odds) / (reach + TAIL * std)
    right = ca.exp(surprise - (r**2) / 2) / (math.sqrt(2 * math.pi) * std)
    trust = right / (right + wrong)
    weight = trust * use
    after = _shift_estimate(belief, K, near, S, (1 - weight) * near**2, R, weight, shift)
    likely = ca.if_else(use, right + wrong, 1.0)
    return RobustUpdate(after, near, std, ca.if_else(use, trust, 1.0), likely, weight * shift)


def _shift_estimate(
    belief: Gaussian, K: Any, e: Any, S: Any, between: Any, R: Any, weight: Any, shift: Any
) -> Gaussian:
    """Return the state estimate shifted by a share of K e.

    Args:
        belief: of x (N).
        K: gain (N).
        e: innovation.
        S: loss of the covariance along K, per share.
        between: gain of the covariance along the shift of the mean, per share.
        R: variance of v.
        weight: the share.
        shift: the gain by which each variable is moved (N).
    """
    mean, P = belief
    cov = P - covariance_loss(K, shift, weight * S, weight * between)
    least = weight * R * shift**2
    cov += ca.diag(ca.fmax(least - ca.project(ca.diag(cov), least.sparsity()), 0.0))
    return Gaussian(mean + weight * e * shift, mirror_upper(cov))


def covariance_loss(along: Any, shift: Any, certain: Any, between: Any) -> Any:
    """Return the loss of a covariance: g certain g' - (g - s) certain (g - s)' - s between s'.

    The result is its upper triangle. For variables that are moved fully (s = g) it is one product
    of g with another vector, which only variables moved in part make longer.

    Args:
        along: g, along which bounds or a reading would move the mean (N x k).
        shift: s, along which they do (N x k).
        certain: loss of the covariance if they are right (k x k).
        between: by how much it is more, as they may be wrong (k x k).
    """
    rest = ca.sparsify(along - shift)
    moved_in_part = sorted(set(rest.sparsity().row()))
    lost = along @ (ca.mtimes(certain - between, along.T) + ca.mtimes(between, rest.T))
    if moved_in_part:
        g = along[moved_in_part, :]
        s = shift[moved_in_part, :]
        half = s @ (ca.mtimes(certain, g.T) - ca.mtimes((certain + between) / 2, s.T))
        lost[moved_in_part, :] = lost[:, moved_in_part].T
        lost[moved_in_part, moved_in_part] = half + half.T
    return lost


def stack_updates(readings: Sequence[RobustUpdate]) -> RobustUpdate:
    """Return the result of consecutive measurement updates, with scalars stacked as columns."""
    return RobustUpdate(
        belief=readings[-1].belief,
        e=ca.vertcat(*(one.e for one in readings)),
        std=ca.vertcat(*(one.std for one in readings)),
        trust=ca.vertcat(*(one.trust for one in readings)),
        likely=ca.vertcat(*(one.likely for one in readings)),
        gain=ca.horzcat(*(one.gain for one in readings)),
    )


class Bound(NamedTuple):
    """Condition excess + h (x - x^) + v <= 0, if it is used.

    Attributes:
        h: row of the bound (1 x N).
        excess: by which the mean x^ lies beyond it.
        use: 0 leaves the belief as it is.
    """

    h: Any
    excess: Any
    use: Any


class TruncationUpdate(NamedTuple):
    """Result of a truncation at the bounds of a reading that may be fake.

    Attributes:
        belief: mean and covariance of the mixture of both cases.
        used: whether each bound was used.
        trust: probability that the reading is not fake, used or not.
        likely: its predicted probability (1 if no bound was used).
    """

    belief: Gaussian
    used: tuple[Any, ...]
    trust: Any
    likely: Any


def truncate_at_bounds(
    belief: Gaussian,
    bounds: Sequence[Bound],
    R: Any,
    limit: float,
    fake: Any = None,
    moved: Any = None,
) -> TruncationUpdate:
    """Return the state estimate given a bound, or both ends of an interval, by moment
    matching.

    Args:
        belief: of x (N), with the mean x^.
        bounds: one, or two that cannot both be exceeded, of one reading.
        R: variance of each v.
        limit: a bound that holds with a probability of at least Phi(limit) is not used.
        fake: log of the probability that the reading is fake (None: it is not).
        moved: share by which the bounds move each variable (N) (None: all move). The information on
            the moved variables is then conditional on those that stay.
    """
    mean, P = belief
    H = ca.vertcat(*(bound.h for bound in bounds))
    K = P @ H.T
    G = H @ K
    moments = (_one_bound_moments if len(bounds) == 1 else _interval_moments)(bounds, G, R, limit)
    trust = ca.SX(1.0)
    likely = 1.0
    between = 0.0
    if fake is not None:
        wrong = ca.exp(fake)
        trust = moments.chance / (moments.chance + wrong)
        anything = ca.mmax(ca.vertcat(*moments.used))
        likely = ca.if_else(anything, moments.chance + wrong, 1.0)
        between = trust * (1 - trust) * (moments.shift @ moments.shift.T)
    moving = K if moved is None else moved * K
    certain = trust * moments.lost
    lost = covariance_loss(K, moving, certain, between)
    after = Gaussian(mean + moving @ (trust * moments.shift), mirror_upper(P - lost))
    return TruncationUpdate(after, moments.used, trust, likely)


class _BoundMoments(NamedTuple):
    """Moments of the k variables h x, of covariance G, given their bounds.

    Attributes:
        shift: x^ moves by P H' shift (k).
        lost: the covariance loses P H' lost H P (k x k).
        used: whether each bound is used.
        chance: of the bounds, used or not.
    """

    shift: Any
    lost: Any
    used: tuple[Any, ...]
    chance: Any


def _one_bound_moments(bounds: Sequence[Bound], G: Any, R: Any, limit: float) -> _BoundMoments:
    """Return the moments given a single bound."""
    (bound,) = bounds
    std = ca.sqrt(ca.fmax(G, 0.0) + R)
    alpha = ca.fmax(-bound.excess / std, -CLIP)
    used = ca.logic_and(bound.use, alpha < limit)
    likely, ratio = normal_cdf_and_hazard(alpha)
    return _BoundMoments(
        *_shift_and_loss(ca.if_else(used, ratio, 0.0), alpha, std), (used,), likely
    )


def _interval_moments(bounds: Sequence[Bound], G: Any, R: Any, limit: float) -> _BoundMoments:
    """Return the moments given both ends of an interval.

    No value is beyond both, so that the probability of the interval is Phi(a) + Phi(b) - 1, with a
    and b how far inside of its ends the mean lies, in standard deviations. Its moments follow from
    the slope and the bend of its log. Both are used if more than 1 - Phi(limit) of the probability
    that either leaves is beyond the other. An estimate may be such that both are exceeded at times.
    If these moments are invalid for it, and far outside, the nearer end is used alone.
    """
    std = ca.sqrt(ca.fmax(ca.diag(G), 0.0) + R)
    alpha = ca.fmax(-ca.vertcat(*(bound.excess for bound in bounds)) / std, -CLIP)
    use = ca.vertcat(*(bound.use for bound in bounds))
    is_used = ca.logic_and(use, alpha < limit)
    lower = ca.fmin(alpha[0], alpha[1])
    inside = ca.vertcat(_normal_cdf_limited(alpha[0]), _normal_cdf_limited(alpha[1]))
    other = ca.vertcat(inside[1], inside[0])
    nearest = ca.fmin(inside[0], inside[1])
    left = ca.fmax(inside[0] + inside[1] - 1, NARROW * nearest)
    each = (normal_cdf_and_hazard(alpha[0]), normal_cdf_and_hazard(alpha[1]))
    ratio = ca.vertcat(each[0][1], each[1][1])
    pair = ratio * inside / left
    unsure = (1 - math.erf(limit / math.sqrt(2))) / 2
    both = ca.logic_and(use, 1 - inside > unsure * other)
    both = ca.logic_and(ca.mmin(both), ca.logic_and(ca.mmax(is_used), lower > -DEEP))
    both = ca.logic_and(both, _is_valid_covariance(_shift_and_loss(pair, alpha, std)[1], G))
    used_limits = ca.if_else(is_used, alpha, CLIP)
    first = used_limits[0] <= used_limits[1]
    alone = ca.logic_and(is_used, ca.vertcat(first, ca.logic_not(first)))
    slope = ca.if_else(both, pair, ca.if_else(alone, ratio, 0.0))
    used = ca.logic_or(both, alone)
    likely = ca.fmin(each[0][0], each[1][0]) * (left / nearest)
    return _BoundMoments(*_shift_and_loss(slope, alpha, std), (used[0], used[1]), likely)


def _shift_and_loss(slope: Any, alpha: Any, std: Any) -> tuple[Any, Any]:
    """Return `shift` (k) and `lost` (k x k), given the slope of the log probability in each
    alpha (k).
    """
    shift = -slope / std
    return shift, shift @ shift.T + ca.diag(slope * alpha / std**2)


def _is_valid_covariance(lost: Any, G: Any) -> Any:
    """Return whether G - G lost G is a covariance that does not exceed G (2 x 2 each)."""
    trace = ca.sum1(ca.sum2(lost * G))
    det = (lost[0, 0] * lost[1, 1] - lost[0, 1] ** 2) * (G[0, 0] * G[1, 1] - G[0, 1] ** 2)
    below = ca.logic_and(trace < 2, 1 - trace + det > 0)
    return ca.logic_and(below, ca.logic_and(trace > 0, det > -NARROW))
