"""Unscented transform on CasADi expressions: 2 N + 1 points represent a Gaussian.

docs/methods/nonlinear_filters.md derives it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.gaussian import Gaussian

ROUNDING = 1e-14  # of a variance: a smaller rest after elimination counts as 0


class SigmaWeights(NamedTuple):
    """Scaled weights of van der Merwe (2004).

    Attributes:
        mean, cov: of the mean's point, in means and in covariances.
        other: of every other point.
        spread: the square of the distance of the points from the mean, in standard deviations.
    """

    mean: float
    cov: float
    other: float
    spread: float


def sigma_weights(size: int, alpha: float, beta: float, kappa: float) -> SigmaWeights:
    """Return the weights for `size` variables.

    The points lie alpha sqrt(size + kappa) standard deviations from the mean.
    """
    spread = alpha**2 * (size + kappa)
    centre = 1 - size / spread
    return SigmaWeights(centre, centre + 1 - alpha**2 + beta, 0.5 / spread, spread)


def cholesky_factor(cov: Any) -> Any:
    """Return the Cholesky factor L with L L' = cov (N x N).

    The column of a direction without variance is 0, so that rounding cannot stop it.
    """
    size = cov.shape[0]
    L = ca.SX(size, size)
    for j in range(size):
        rest = cov[j:, j] - L[j:, :j] @ L[j, :j].T
        some = rest[0] > ROUNDING * cov[j, j]
        L[j:, j] = ca.if_else(some, rest / ca.sqrt(ca.if_else(some, rest[0], 1.0)), 0.0)
    return L


def sigma_points(belief: Gaussian, w: SigmaWeights) -> list[Any]:
    """Return the mean, then a point on either side of it along every column of the factor."""
    steps = ca.horzsplit(math.sqrt(w.spread) * cholesky_factor(belief.cov))
    ahead = [belief.mean + step for step in steps]
    behind = [belief.mean - step for step in steps]
    return [belief.mean, *ahead, *behind]


def points_mean(values: list[Any], w: SigmaWeights) -> Any:
    """Return the weighted mean of the mapped points."""
    return w.mean * values[0] + w.other * sum(values[1:], ca.SX(*values[0].shape))


def points_covariance(first: list[Any], second: list[Any], w: SigmaWeights) -> Any:
    """Return the weighted covariance of the points' deviations from two means."""
    others = ca.SX(first[0].shape[0], second[0].shape[0])
    for a, b in zip(first[1:], second[1:], strict=True):
        others = others + a @ b.T
    return w.cov * first[0] @ second[0].T + w.other * others


def predict_by_points(
    belief: Gaussian, change: Callable[[Any], Any], Q: Any, w: SigmaWeights
) -> Gaussian:
    """Predict the state estimate after x+ = x + f(x) + v. The result is exact if f is linear.

    Args:
        belief: of x (N).
        change: f, by which the model changes x.
        Q: covariance of v (N x N).
        w: the weights.
    """
    moved = [point + change(point) for point in sigma_points(belief, w)]
    centre = points_mean(moved, w)
    off = [value - centre for value in moved]
    return Gaussian(centre, _symmetrise(points_covariance(off, off, w) + Q))


def gain_by_points(
    belief: Gaussian, h: Callable[[Any], Any], R: Any, w: SigmaWeights
) -> tuple[Any, Any, Any]:
    """Return the measurement update of one reading y = h(x) + v.

    Args:
        belief: of x (N).
        h: the sensor.
        R: variance of v.
        w: the weights.

    Returns:
        The expected y, its variance, and the gain K (N).
    """
    spread = sigma_points(belief, w)
    read = list(map(h, spread))
    expected = points_mean(read, w)
    off = [value - expected for value in read]
    S = points_covariance(off, off, w) + R
    K = points_covariance([point - belief.mean for point in spread], off, w) / S
    return expected, S, K


def _symmetrise(cov: Any) -> Any:
    """Return the symmetric matrix of an upper triangle, with all entries stored."""
    return ca.triu2symm(ca.triu(ca.densify(cov)))
