"""Gaussian beliefs on CasADi expressions: move through a model, correct by a reading, cut at a bound (docs/filters.md)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca


class Gaussian(NamedTuple):
    """Mean (N) and covariance (N x N, symmetric)."""

    mean: Any
    cov: Any


def triangle(cov: Any, entries: ca.Sparsity) -> Any:
    """Those entries of a symmetric matrix, of its upper triangle, column by column."""
    return ca.project(cov, entries).nz[:]


def symmetric(column: Any, entries: ca.Sparsity) -> Any:
    """The symmetric matrix whose `triangle` is given: 0, and known to be 0, outside these entries."""
    return ca.triu2symm(ca.SX(entries, column))


def linearise(f: Callable[[Any], Any], at: Any) -> tuple[Any, Any]:
    """f and its Jacobian at a column."""
    X = ca.SX.sym("X", at.shape[0])
    value = f(X)
    found, slope = ca.substitute([value, ca.jacobian(value, X)], [X], [at])
    return found, slope


def predict(
    belief: Gaussian,
    f: Callable[[Any], Any],
    Q: Any,
    lasting: Any = 1.0,
    bend: Callable[[Any], tuple[Any, Any]] | None = None,
) -> Gaussian:
    """The belief after x+ = f(x) + w, cov w = Q (N x N), to second order; exact for f of degree 2, lasting = 1.

    What f bends beyond its mean is not white: it keeps its sign for about `lasting` steps and counts that much more.
    bend(x) = (G (N x M), b (M)): all that is bent in f(x) is, nearly, in G b(x); with few b, much cheaper.
    """
    P, X = belief.cov, ca.SX.sym("X", belief.mean.shape[0])
    value = f(X)
    spread, bent = (ca.SX.eye(X.shape[0]), value) if bend is None else bend(X)
    rows = [row for row, nonlinear in enumerate(ca.which_depends(bent, X, 2, True)) if nonlinear]
    mean, F, *curvatures = ca.substitute(
        [value, ca.jacobian(value, X), *(ca.hessian(bent[row], X)[0] for row in rows)],
        [X],
        [belief.mean],
    )
    products = [H @ P for H in curvatures]
    shift, excess = ca.SX(bent.shape[0], 1), ca.SX(bent.shape[0], bent.shape[0])
    for row, M in zip(rows, products, strict=True):
        shift[row] = ca.trace(M) / 2
        for column, other in zip(rows, products, strict=True):
            excess[row, column] = lasting * ca.dot(M, other.T) / 2
    return Gaussian(
        mean + spread @ shift, _from_upper(F @ P @ F.T + Q + spread @ excess @ spread.T)
    )


def advance(belief: Gaussian, f: Callable[[Any], Any], Q: Any, F: Any = None) -> Gaussian:
    """The belief after x+ = f(x) + w, cov w = Q (N x N), to first order; F: the Jacobian to take (default: that of f at the mean)."""
    mean, slope = linearise(f, belief.mean) if F is None else (f(belief.mean), F)
    return Gaussian(mean, _from_upper(slope @ belief.cov @ slope.T + Q))


def update(belief: Gaussian, h: Any, e: Any, R: Any, use: Any) -> tuple[Gaussian, Any]:
    """(the belief after one reading h x + v, variance of its innovation e); unchanged where `use` is 0.

    Joseph's form, so that rounding cannot make the covariance indefinite.
    """
    mean, P = belief
    S = h @ P @ h.T + R
    K = use * (P @ h.T) / S
    half = P - K @ (h @ P)
    return Gaussian(
        mean + K @ ca.if_else(use, e, 0.0), _from_upper(half - (half @ h.T) @ K.T + R * (K @ K.T))
    ), S


def truncate(
    belief: Gaussian, h: Any, excess: Any, R: Any, use: Any, limit: float
) -> tuple[Gaussian, Any]:
    """(the belief given that excess + h (x - x^) + v <= 0, 1 where that was used), by matching mean and covariance.

    Used where `use` holds and the belief does not say so already: where its probability is below Phi(limit).
    """
    mean, P = belief
    std = ca.sqrt(h @ P @ h.T + R)
    alpha = -excess / std
    used = ca.logic_and(use, alpha < limit)
    ratio = ca.if_else(used, hazard(alpha), 0.0)
    along = P @ h.T / std
    return Gaussian(
        mean - ratio * along, _from_upper(P - ratio * (ratio + alpha) * (along @ along.T))
    ), used


def truncate_to(belief: Gaussian, i: int, low: Any, high: Any) -> tuple[Gaussian, Any]:
    """(the belief given low <= x_i <= high, by matching mean and covariance, the log of its chance); unchanged below a chance of 1e-6."""
    mean, P = belief
    std = ca.sqrt(P[i, i])
    a, b = (low - mean[i]) / std, (high - mean[i]) / std
    chance = (ca.erf(b / math.sqrt(2)) - ca.erf(a / math.sqrt(2))) / 2
    at_a, at_b = (ca.exp(-(x**2) / 2) / math.sqrt(2 * math.pi) for x in (a, b))
    share = ca.if_else(chance > 1e-6, 1 / chance, 0.0)
    shift = (at_a - at_b) * share
    along = P[:, i] / std
    cov = P - (shift**2 + (b * at_b - a * at_a) * share) * (along @ along.T)
    return Gaussian(mean + shift * along, _from_upper(cov)), ca.log(ca.fmax(chance, 1e-300))


def mix(first: Gaussian, second: Gaussian, share: Any) -> Gaussian:
    """Mean and covariance of the mixture: `first` with probability `share`, else `second`."""
    gap = first.mean - second.mean
    spread = share * first.cov + (1 - share) * second.cov + share * (1 - share) * gap @ gap.T
    return Gaussian(share * first.mean + (1 - share) * second.mean, _from_upper(spread))


def hazard(alpha: Any) -> Any:
    """phi(alpha) / Phi(alpha) of the standard normal distribution; its asymptotic series below -5 (1e-4 accurate there)."""
    near, far = ca.fmax(alpha, -5.0), ca.fmax(-alpha, 5.0)
    exact = ca.exp(-(near**2) / 2) / (math.sqrt(math.pi / 2) * (1 + ca.erf(near / math.sqrt(2))))
    return ca.if_else(alpha > -5.0, exact, far + (1 - (2 - 10 / far**2) / far**2) / far)


def _from_upper(cov: Any) -> Any:
    return ca.triu2symm(ca.triu(cov))
