"""How well noisy readings determine x(0), d and a bias along a schedule: information, backward in time (docs/identifiability.md)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.error_dynamics import pattern
from undeadzone.analysis.identifiability.linear import DIRECTIONS, invisible
from undeadzone.analysis.side_schedule import Schedule, merged
from undeadzone.linear.matrices import Matrices
from undeadzone.support.arrays import Floats

EXACT = 1e-6  # of an edge: the least rms that a reading is taken to have
BLURRED = 1e-4  # the same beside process noise, which makes some direction so vague that rounding would hide it


class Stretch(NamedTuple):
    """What a stretch of time does to information: before = H + Phi' (after^-1 + Q)^-1 Phi, all N x N.

    Phi: the transition; Q: covariance that process noise adds; H: the observability Gramian of the stretch's readings.
    """

    Phi: Floats
    Q: Floats
    H: Floats


class Deviations(NamedTuple):
    """Standard deviations that an optimal estimator reaches: inf where a direction is not identifiable.

    widths: of `right`, `left`, `width`, `centre` of each output; states (n): of x(0); covariance (n + 2p + b square): of
    [x(0); d; beta], its unidentifiable part left out; information: the inverse, whole.
    """

    widths: list[dict[str, float]]
    states: Floats
    covariance: Floats
    information: Floats


def deviations(
    linear: Matrices,
    schedule: Schedule,
    noise: Floats,
    step: float,
    duration: float,
    bias: Floats | None = None,
    process: Floats | None = None,
) -> Deviations:
    """What readings with noise (p, rms of z) every `step` [s] for `duration` [s] tell, whole passes of the schedule at a time.

    bias: directions (n x b) of unknown constant inputs; process (n x n): covariance of white process noise, per second, or
    per step if the schedule is sampled. No prior is used.
    """
    n, p = linear.A.shape[0], linear.C.shape[0]
    least = (EXACT if process is None else BLURRED) * schedule.levels.max(axis=1)
    found = information(
        linear, schedule, np.maximum(noise, least) ** 2, step, duration, bias, process
    )
    hidden = invisible(linear, schedule.visited(n), schedule.Ts, bias)
    scale = hidden.scale
    seen = np.linalg.svd(hidden.basis)[0][:, hidden.basis.shape[1] :]
    covariance = np.outer(scale, scale) * (
        seen @ _inverse(seen.T @ (found * np.outer(scale, scale)) @ seen) @ seen.T
    )

    def widths(i: int) -> dict[str, float]:
        pair = covariance[n + 2 * i : n + 2 * i + 2, n + 2 * i : n + 2 * i + 2]
        return {
            name: float(np.sqrt(np.array(g) @ pair @ np.array(g)))
            if hidden.width(i, name)
            else np.inf
            for name, g in DIRECTIONS.items()
        }

    states = np.array([np.sqrt(covariance[i, i]) if hidden.state(i) else np.inf for i in range(n)])
    return Deviations([widths(i) for i in range(p)], states, covariance, found)


def information(
    linear: Matrices,
    schedule: Schedule,
    variance: Floats,
    step: float,
    duration: float,
    bias: Floats | None = None,
    process: Floats | None = None,
) -> Floats:
    """The information matrix of [x(0); d; beta], per stretch of constant side, put together by doubling.

    Without process noise it is exact: the observability Gramian of the switched system divided by the noise; see `deviations`.
    """
    n, p = linear.A.shape[0], linear.C.shape[0]
    B = np.zeros((n, 0)) if bias is None else bias
    size = n + 2 * p + B.shape[1]
    F, Q = np.zeros((size, size)), np.zeros((size, size))
    F[:n, :n], F[:n, n + 2 * p :] = linear.A, B
    if process is not None:
        Q[:n, :n] = process
    once = None
    for sides, span in zip(*merged(schedule)[:2], strict=True):
        rows = np.hstack(
            [
                linear.C * np.abs(sides)[:, None],
                -pattern(tuple(sides.astype(int))),
                np.zeros((p, B.shape[1])),
            ]
        )
        if schedule.Ts is None:
            stretch = _flow(F, Q, rows.T / (variance * step) @ rows, span, step)
        else:
            stretch = repeat(
                Stretch(
                    F + np.diag(np.r_[np.zeros(n), np.ones(size - n)]), Q, rows.T / variance @ rows
                ),
                round(span),
            )
        once = stretch if once is None else then(once, stretch)
    assert once is not None
    return repeat(once, max(1, int(duration / schedule.duration * (1 + 1e-12)))).H


def then(first: Stretch, second: Stretch) -> Stretch:
    """One stretch after another."""
    both = np.linalg.solve(
        np.eye(first.Q.shape[0]) + first.Q @ second.H, np.hstack([first.Phi, first.Q])
    )
    Phi, Q = np.hsplit(both, 2)
    H = first.H + first.Phi.T @ second.H @ Phi
    Q = second.Q + second.Phi @ Q @ second.Phi.T
    return Stretch(second.Phi @ Phi, (Q + Q.T) / 2, (H + H.T) / 2)


def repeat(once: Stretch, times: int) -> Stretch:
    """A stretch `times` >= 1 times in a row, by doubling."""
    found = None
    while True:
        if times & 1:
            found = once if found is None else then(found, once)
        times >>= 1
        if not times:
            assert found is not None
            return found
        once = then(once, once)


def _flow(F: Floats, Q: Floats, H: Floats, span: float, step: float) -> Stretch:
    """The stretch of x' = F x + w, cov w = Q, with information H per second, for `span` [s]: short parts, then doubling.

    Within a part readings come before process noise: with Q, a part holds one reading (every `step` [s]) at most.
    """
    from scipy.linalg import expm

    parts = max(1.0, float(np.linalg.norm(F, 1)) * span, span / step if Q.any() else 1.0)
    halvings = int(np.ceil(np.log2(parts)))
    part = span / 2**halvings
    return repeat(
        Stretch(expm(F * part), _gramian(F, Q, part), _gramian(F.T, H, part)), 2**halvings
    )


def _gramian(F: Floats, Q: Floats, span: float) -> Floats:
    """The integral of e^(F s) Q e^(F' s) from 0 to `span` [s] (Van Loan 1978)."""
    from scipy.linalg import expm

    N, size = F.shape[0], float(np.abs(Q).max()) or 1.0
    E = expm(np.block([[-F, Q / size], [np.zeros((N, N)), F.T]]) * span)
    return np.asarray(size * E[N:, N:].T @ E[:N, N:])


def _inverse(information: Floats) -> Floats:
    """The inverse of a positive semidefinite matrix, infinite where rounding leaves nothing."""
    unit = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(unit, unit))
    return np.asarray(
        (vectors / np.maximum(values, np.finfo(float).tiny)) @ vectors.T / np.outer(unit, unit)
    )
