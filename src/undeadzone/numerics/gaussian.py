"""Gaussian beliefs on CasADi expressions: predict, correct by a reading, truncate at a bound.

docs/filters.md derives them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca


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
