"""What noise, disturbance and model error become in the estimate: mean squares along the reference.

docs/rates.md derives them. Every function takes many candidate gains at once, along the first axes
of F (..., K, N, N).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.convergence.floquet import product
from undeadzone.analysis.side_schedule import Schedule
from undeadzone.support.arrays import Floats

TERMS = 12  # of Taylor series whose terms shrink by 1/4 or more
PASSES = 30  # doublings of the number of passes until the steady state, at most


class Span(NamedTuple):
    """K spans of constant side (..., K, N, N each).

    Attributes:
        Phi: the transition matrix.
        G: the sum of Phi_t'H Phi_t over the span.
        GG: the sum over the span of G_t, which is that sum up to t.
        length: of the span, in its unit (K, 1, 1).
    """

    Phi: Floats
    G: Floats
    GG: Floats
    length: Floats


def spans(F: Floats, H: Floats, schedule: Schedule) -> Span:
    """Every span of a schedule for x' = F x (or x+ = (I + Ts F) x).

    Args:
        F: the dynamics in each span (..., K, N, N) [1/s].
        H: the weight of x (..., N, N).
        schedule: of the sides.
    """
    if schedule.Ts is not None:
        step = np.broadcast_to(np.eye(F.shape[-1]), F.shape) + schedule.Ts * F
        length = np.ones((F.shape[-3], 1, 1))
        return _power(
            Span(step, np.broadcast_to(H, F.shape), 0 * F, length), schedule.spans.astype(int)
        )
    norm = np.abs(F).sum(axis=-1).max(axis=-1).reshape(-1, F.shape[-3]).max(axis=0)
    halvings = np.ceil(np.log2(np.maximum(8 * norm * schedule.spans, 1.0))).astype(int)
    h = (schedule.spans / 2.0**halvings)[:, None, None]
    # Taylor series over h: of Phi with terms (F h)^k / k!, of G and GG with derivatives of G_t.
    power = np.eye(F.shape[-1]) + 0 * F
    Phi = np.eye(F.shape[-1]) + 0 * F
    G, GG, term = 0 * F, 0 * F, H + 0 * F
    for k in range(1, TERMS):
        coefficient = h / k
        power = power @ F * coefficient
        Phi = Phi + power
        G = G + coefficient * term
        GG = GG + coefficient * (h / (k + 1)) * term
        term = coefficient * (_t(F) @ term + term @ F)
    return _power(Span(Phi, G, GG, h), 2**halvings)


def mean_squares(
    F: Floats, Z: Floats, sources: Sequence[Floats], schedule: Schedule
) -> list[Floats]:
    """Mean over a pass of |Z x|^2 in the steady state of x' = F x + v, v white, for each source.

    Sampled, x+ = (I + Ts F) x + v, and the mean is over the samples. Large if x does not settle.

    Args:
        F: the dynamics in each span (..., K, N, N) [1/s].
        Z: rows of what counts (rows x N).
        sources: covariances of v (..., K, N, N), per second, or per step if sampled.
        schedule: of the sides.
    """
    over = spans(F, Z.T @ Z, schedule)
    K = F.shape[-3]
    means = []
    for source in sources:
        spread = spans(_t(F), source, schedule).G  # what one span adds to the covariance
        covariance = _settled(over.Phi, spread)
        total = (over.GG * source).sum(axis=(-3, -2, -1))
        for k in range(K):
            total = total + (over.G[..., k, :, :] * covariance).sum(axis=(-2, -1))
            covariance = _along(over.Phi, covariance, k) + spread[..., k, :, :]
        means.append(np.asarray(total / schedule.spans.sum()))
    return means


def _settled(Phi: Floats, spread: Floats) -> Floats:
    """The covariance (..., N, N) at the start of a pass after many passes, by doubling."""
    covariance: Floats = np.zeros(Phi.shape[:-3] + Phi.shape[-2:])
    for k in range(Phi.shape[-3]):
        covariance = _along(Phi, covariance, k) + spread[..., k, :, :]
    M = _whole(Phi)
    for _ in range(PASSES):
        covariance, M = covariance + M @ covariance @ _t(M), M @ M
        if not np.abs(M).max(initial=0.0) > 1e-9:
            break
    return covariance


def forced_mean_square(
    F: Floats, Z: Floats, push: Floats, S: Floats, starts: Floats, schedule: Schedule
) -> Floats:
    """Mean over a pass of sum_j |Z x_j|^2 in the steady state of x_j' = F x_j + push_j w, w' = S w.

    The pass is taken as repeated. F, push and S are in delta form if sampled.

    Args:
        F: the dynamics in each span (..., K, N, N) [1/s].
        Z: rows of what counts (rows x N).
        push: how w drives each x_j (J, N, k).
        S: of the exosystem (k x k) [1/s].
        starts: w at the start of each span (K, k).
        schedule: of the sides.
    """
    N, k = push.shape[1:]
    weight = np.zeros((N + k, N + k))
    weight[:N, :N] = Z.T @ Z
    total = np.zeros(F.shape[:-3])
    for E in push:
        over = spans(_with_exosystem(F, E, S), weight, schedule)
        x: Floats = np.zeros((*F.shape[:-3], N))
        for span, w in enumerate(starts):
            x = _onward(x, w, over.Phi[..., span, :, :])
        # x is now what one pass adds; in the steady state x = (what is left of x) + that.
        once = np.eye(N) - _whole(over.Phi[..., :N, :N])
        x = (np.linalg.pinv(once, rcond=1e-12) @ x[..., None])[..., 0]
        for span, w in enumerate(starts):
            both = np.concatenate([x, np.broadcast_to(w, (*x.shape[:-1], k))], axis=-1)
            G = over.G[..., span, :, :]
            total = total + (both[..., None, :] @ G @ both[..., None])[..., 0, 0]
            x = _onward(x, w, over.Phi[..., span, :, :])
    return np.asarray(total / schedule.spans.sum())


def _with_exosystem(F: Floats, E: Floats, S: Floats) -> Floats:
    """The dynamics (..., K, N + k, N + k) of (x, w): x' = F x + E w, w' = S w."""
    N, k = E.shape
    joined = np.zeros((*F.shape[:-2], N + k, N + k))
    joined[..., :N, :N] = F
    joined[..., :N, N:] = E
    joined[..., N:, N:] = S
    return joined


def _onward(x: Floats, w: Floats, Phi: Floats) -> Floats:
    """x (..., N) at the end of a span that starts with x and w (k); Phi: transition of (x, w)."""
    N = x.shape[-1]
    return np.asarray((Phi[..., :N, :N] @ x[..., None] + Phi[..., :N, N:] @ w[:, None])[..., 0])


def _power(one: Span, times: Floats) -> Span:
    """Each span as often as `times` says (K), by doubling."""
    identity = np.broadcast_to(np.eye(one.Phi.shape[-1]), one.Phi.shape)
    whole = Span(identity, 0 * one.G, 0 * one.GG, 0 * one.length)
    while True:
        odd = times % 2 == 1
        if odd.any():
            longer = _then(whole, one)
            chosen = odd[:, None, None]
            parts = [np.where(chosen, new, old) for new, old in zip(longer, whole, strict=True)]
            whole = Span(*parts)
        times = times // 2
        if not times.any():
            return whole
        one = _then(one, one)


def _then(a: Span, b: Span) -> Span:
    """Span b after span a."""
    Pt = _t(a.Phi)
    return Span(
        b.Phi @ a.Phi,
        a.G + Pt @ b.G @ a.Phi,
        a.GG + b.length * a.G + Pt @ b.GG @ a.Phi,
        a.length + b.length,
    )


def _along(Phi: Floats, covariance: Floats, k: int) -> Floats:
    """A covariance (..., N, N) at the end of span k."""
    return np.asarray(Phi[..., k, :, :] @ covariance @ _t(Phi[..., k, :, :]))


def _whole(Phi: Floats) -> Floats:
    """The transition (..., N, N) over all spans."""
    M, size = product(Phi)
    return np.asarray(M * np.exp(size)[..., None, None])


def _t(M: Floats) -> Floats:
    """Transposed matrices."""
    return np.swapaxes(M, -1, -2)
