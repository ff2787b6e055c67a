"""Gaussian beliefs on CasADi expressions: predict, update by one reading, cut at a bound (docs/filters.md)."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca


class Gaussian(NamedTuple):
    """Mean (N) and covariance (N x N, symmetric)."""

    mean: Any
    cov: Any


def triangle(cov: Any) -> Any:
    """The upper triangle of a symmetric N x N matrix, column by column (N (N + 1) / 2)."""
    return ca.vertcat(*(cov[: column + 1, column] for column in range(cov.shape[1])))


def symmetric(column: Any, size: int) -> Any:
    """The symmetric size x size matrix of a `triangle`."""
    return ca.triu2symm(ca.SX(ca.Sparsity.upper(size), column))


def predict(belief: Gaussian, mean: Any, F: Any, Q: Any) -> Gaussian:
    """The belief after x+ = f(x) + w: mean f(x^), F = df/dx at x^, Q = cov w."""
    return Gaussian(mean, ca.triu2symm(ca.triu(F @ belief.cov @ F.T + Q)))


def update(belief: Gaussian, h: Any, e: Any, R: Any, use: Any) -> tuple[Gaussian, Any]:
    """(the belief after one reading, its innovation variance): innovation e, row h (1 x N), noise variance R.

    Joseph's form, so that rounding cannot make the covariance indefinite; unchanged where `use` is 0.
    """
    m, P = belief
    S = h @ P @ h.T + R
    K = use * (P @ h.T) / S
    half = P - K @ (h @ P)
    return Gaussian(m + K @ ca.if_else(use, e, 0.0), ca.triu2symm(ca.triu(half - (half @ h.T) @ K.T + R * (K @ K.T)))), S


def room(belief: Gaussian, h: Any, bound: Any, R: Any) -> Any:
    """alpha = (bound - h x^) / std(h x + v), v of variance R: h x + v <= bound has probability Phi(alpha)."""
    return (bound - h @ belief.mean) / ca.sqrt(h @ belief.cov @ h.T + R)


def cut(belief: Gaussian, h: Any, bound: Any, R: Any, use: Any) -> Gaussian:
    """The belief given h x + v <= bound, by matching mean and covariance; unchanged where `use` is 0."""
    m, P = belief
    alpha = room(belief, h, bound, R)
    ratio = ca.if_else(use, hazard(alpha), 0.0)
    along = P @ h.T / ca.sqrt(h @ P @ h.T + R)
    return Gaussian(m - ratio * along, ca.triu2symm(ca.triu(P - ratio * (ratio + alpha) * (along @ along.T))))


def hazard(alpha: Any) -> Any:
    """phi(alpha) / Phi(alpha) of the standard normal distribution; its asymptotic series below -5."""
    near, far = ca.fmax(alpha, -5.0), ca.fmax(-alpha, 5.0)
    exact = ca.exp(-(near**2) / 2) / (1.2533141373155003 * (1 + ca.erf(near / 1.4142135623730951)))
    return ca.if_else(alpha > -5.0, exact, far + (1 - (2 - 10 / far**2) / far**2) / far)
