"""The unscented transform on CasADi expressions: a Gaussian belief carried by 2 N + 1 points (docs/methods/ukf.md)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from undeadzone.numerics.gaussian import Gaussian

ROUNDING = 1e-14  # of a variance: what is left of it after elimination is taken for 0


class Weights(NamedTuple):
    """Scaled weights of van der Merwe (2004): of the mean's point in means and covariances, of every other point, and spread^2."""

    mean: float
    cov: float
    other: float
    spread: float


def weights(size: int, alpha: float, beta: float, kappa: float) -> Weights:
    """The weights for `size` variables, whose points lie alpha sqrt(size + kappa) standard deviations from the mean."""
    spread = alpha**2 * (size + kappa)
    centre = 1 - size / spread
    return Weights(centre, centre + 1 - alpha**2 + beta, 0.5 / spread, spread)


def factor(cov: Any) -> Any:
    """Cholesky's L with L L' = cov; columns of a direction without variance are 0, so that rounding cannot stop it."""
    size = cov.shape[0]
    L = ca.SX(size, size)
    for j in range(size):
        rest = cov[j:, j] - L[j:, :j] @ L[j, :j].T
        some = rest[0] > ROUNDING * cov[j, j]
        L[j:, j] = ca.if_else(some, rest / ca.sqrt(ca.if_else(some, rest[0], 1.0)), 0.0)
    return L


def points(belief: Gaussian, w: Weights) -> list[Any]:
    """The mean, then a point on either side of it along every column of the factor."""
    steps = ca.horzsplit(math.sqrt(w.spread) * factor(belief.cov))
    return [
        belief.mean,
        *(belief.mean + step for step in steps),
        *(belief.mean - step for step in steps),
    ]


def mean(values: list[Any], w: Weights) -> Any:
    """The weighted mean of what the points became."""
    return w.mean * values[0] + w.other * sum(values[1:], ca.SX(*values[0].shape))


def covariance(first: list[Any], second: list[Any], w: Weights) -> Any:
    """The weighted covariance of deviations from two means."""
    others = zip(first[1:], second[1:], strict=True)
    return w.cov * first[0] @ second[0].T + w.other * sum(
        (a @ b.T for a, b in others), ca.SX(first[0].shape[0], second[0].shape[0])
    )


def predict(belief: Gaussian, f: Callable[[Any], Any], Q: Any, w: Weights) -> Gaussian:
    """The belief after x+ = f(x) + v, cov v = Q (N x N); exact where f is linear."""
    moved = [f(point) for point in points(belief, w)]
    centre = mean(moved, w)
    off = [value - centre for value in moved]
    return Gaussian(centre, _symmetric(covariance(off, off, w) + Q))


def update(
    belief: Gaussian, h: Callable[[Any], Any], y: Any, R: Any, use: Any, w: Weights
) -> tuple[Gaussian, Any, Any]:
    """(the belief after one reading y = h(x) + v, var v = R, its innovation, the variance of that); unchanged where `use` is 0."""
    spread = points(belief, w)
    read = [h(point) for point in spread]
    expected = mean(read, w)
    off = [value - expected for value in read]
    S = covariance(off, off, w) + R
    K = use * covariance([point - belief.mean for point in spread], off, w) / S
    e = ca.if_else(use, y - expected, 0.0)
    return Gaussian(belief.mean + K * e, _symmetric(belief.cov - S * (K @ K.T))), e, S


def _symmetric(cov: Any) -> Any:
    return ca.triu2symm(ca.triu(ca.densify(cov)))
