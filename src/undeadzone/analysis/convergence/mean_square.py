"""What noise, disturbance and model error become in the estimate: mean squares along the reference (docs/rates.md).

Every function takes many candidate gains at once, along the first axes of F (..., K, N, N).
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
    """One span of constant side: Phi, the transition matrix; G = sum Phi_t'H Phi_t over it; GG = sum G_t; its length."""

    Phi: Floats
    G: Floats
    GG: Floats
    length: Floats


def spans(F: Floats, H: Floats, schedule: Schedule) -> Span:
    """Every span of a schedule for x' = F x (or x+ = (I + Ts F) x), F (..., K, N, N), and the weight H (..., N, N) of x."""
    if schedule.Ts is not None:
        identity = np.broadcast_to(np.eye(F.shape[-1]), F.shape)
        return _power(
            Span(
                identity + schedule.Ts * F,
                np.broadcast_to(H, F.shape),
                0 * F,
                np.ones((F.shape[-3], 1, 1)),
            ),
            schedule.spans.astype(int),
        )
    norm = np.abs(F).sum(axis=-1).max(axis=-1).reshape(-1, F.shape[-3]).max(axis=0)
    halvings = np.ceil(np.log2(np.maximum(8 * norm * schedule.spans, 1.0))).astype(int)
    h = (schedule.spans / 2.0**halvings)[:, None, None]
    Phi, power = np.eye(F.shape[-1]) + 0 * F, np.eye(F.shape[-1]) + 0 * F
    G, GG, term = 0 * F, 0 * F, H + 0 * F
    for k in range(1, TERMS):
        power, coefficient = power @ F * (h / k), h / k
        Phi = Phi + power
        G, GG = G + coefficient * term, GG + coefficient * (h / (k + 1)) * term
        term = coefficient * (_t(F) @ term + term @ F)
    return _power(Span(Phi, G, GG, h), 2**halvings)


def mean_squares(
    F: Floats, Z: Floats, sources: Sequence[Floats], schedule: Schedule
) -> list[Floats]:
    """Mean over a pass of |Z x|^2 in the steady state of x' = F x + v, v white of covariance (..., K, N, N) per second, for each source.

    Sampled, x+ = (I + Ts F) x + v with that covariance per step, and the mean is over the samples. Large if x does not settle.
    """
    over = spans(F, Z.T @ Z, schedule)
    K = F.shape[-3]
    found = []
    for source in sources:
        spread = spans(_t(F), source, schedule).G
        covariance = np.zeros(F.shape[:-3] + F.shape[-2:])
        for k in range(K):
            covariance = _along(over.Phi, covariance, k) + spread[..., k, :, :]
        M = _whole(over.Phi)
        for _ in range(PASSES):
            covariance, M = covariance + M @ covariance @ _t(M), M @ M
            if not np.abs(M).max(initial=0.0) > 1e-9:
                break
        total = (over.GG * source).sum(axis=(-3, -2, -1))
        for k in range(K):
            total = total + (over.G[..., k, :, :] * covariance).sum(axis=(-2, -1))
            covariance = _along(over.Phi, covariance, k) + spread[..., k, :, :]
        found.append(np.asarray(total / schedule.spans.sum()))
    return found


def forced_mean_square(
    F: Floats, Z: Floats, push: Floats, S: Floats, starts: Floats, schedule: Schedule
) -> Floats:
    """Mean over a pass of sum_j |Z x_j|^2 in the steady state of x_j' = F x_j + push_j w, w' = S w (delta forms if sampled).

    push (J, N, k); starts (K, k): w at the start of each span. The pass is taken as repeated.
    """
    N, k = push.shape[1:]
    total = np.zeros(F.shape[:-3])
    for E in push:
        joined = np.zeros((*F.shape[:-2], N + k, N + k))
        joined[..., :N, :N], joined[..., :N, N:], joined[..., N:, N:] = F, E, S
        weight = np.zeros((N + k, N + k))
        weight[:N, :N] = Z.T @ Z
        over = spans(joined, weight, schedule)

        def onward(x: Floats, span: int, Phi: Floats = over.Phi) -> Floats:
            return np.asarray(
                (
                    Phi[..., span, :N, :N] @ x[..., None]
                    + Phi[..., span, :N, N:] @ starts[span, :, None]
                )[..., 0]
            )

        x = np.zeros((*F.shape[:-3], N))
        for span in range(starts.shape[0]):
            x = onward(x, span)
        once = np.eye(N) - _whole(over.Phi[..., :N, :N])
        x = (np.linalg.pinv(once, rcond=1e-12) @ x[..., None])[..., 0]
        for span, w in enumerate(starts):
            both = np.concatenate([x, np.broadcast_to(w, (*x.shape[:-1], k))], axis=-1)
            total = (
                total + (both[..., None, :] @ over.G[..., span, :, :] @ both[..., None])[..., 0, 0]
            )
            x = onward(x, span)
    return np.asarray(total / schedule.spans.sum())


def _power(one: Span, times: Floats) -> Span:
    """Each span as often as `times` says (K), by doubling."""
    found = Span(
        np.broadcast_to(np.eye(one.Phi.shape[-1]), one.Phi.shape),
        0 * one.G,
        0 * one.GG,
        0 * one.length,
    )
    while True:
        odd = times % 2 == 1
        if odd.any():
            found = Span(
                *(
                    np.where(odd[:, None, None], new, old)
                    for new, old in zip(_then(found, one), found, strict=True)
                )
            )
        times = times // 2
        if not times.any():
            return found
        one = _then(one, one)


def _then(a: Span, b: Span) -> Span:
    Pt = _t(a.Phi)
    return Span(
        b.Phi @ a.Phi,
        a.G + Pt @ b.G @ a.Phi,
        a.GG + b.length * a.G + Pt @ b.GG @ a.Phi,
        a.length + b.length,
    )


def _along(Phi: Floats, covariance: Floats, k: int) -> Floats:
    return np.asarray(Phi[..., k, :, :] @ covariance @ _t(Phi[..., k, :, :]))


def _whole(Phi: Floats) -> Floats:
    M, size = product(Phi)
    return np.asarray(M * np.exp(size)[..., None, None])


def _t(M: Floats) -> Floats:
    return np.swapaxes(M, -1, -2)
