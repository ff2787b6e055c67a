"""What gains are worth in a design task (docs/rates.md).

That is the rate, gains from disturbance, model error and noise, and the margin of the certificate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.analysis.convergence.floquet import (
    NEUTRAL,
    TINY,
    error_matrices,
    product,
    transitions,
)
from undeadzone.analysis.convergence.mean_square import forced_mean_square, mean_squares
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.task import Task


class Scores(NamedTuple):
    """What b candidates are worth (b each): rate, and rms over the reference of (C x~, d~) [z].

    Attributes:
        rate: of the error [1/s].
        disturbance: rms per unit of white input disturbance, 1 per root second on every input.
        mismatch: rms per unit of relative error in every entry of A and B that is not kinematic,
            independent of each other.
        noise: rms per unit of rms noise on z at every sample.
    """

    rate: Floats
    disturbance: Floats
    mismatch: Floats
    noise: Floats


def score(
    task: Task, L: Floats, gamma: Floats, mismatch: bool = True, gains: bool = True
) -> Scores:
    """What b candidates are worth; nan for what is not asked.

    Args:
        task: the design task.
        L: balanced gains (b, n, p).
        gamma: gains of the widths (b, p).
        mismatch: whether model errors are asked.
        gains: whether disturbance and noise are asked.
    """
    n, p = task.n, task.p
    Gamma = np.repeat(gamma, 2, axis=1)[:, :, None] * np.eye(2 * p)
    F, G = error_matrices(task.A, task.linear.C, L, Gamma, task.schedule.sides)
    rate = -_slowest(task, *product(transitions(F, task.schedule))) / task.schedule.duration
    disturbance = noise = model = np.full(rate.shape, np.nan)
    Z = np.zeros((3 * p, F.shape[-1]))  # the errors that count: C x~, then d~
    Z[:p, :n] = task.linear.C
    Z[p:, n:] = np.eye(2 * p)
    if gains:
        per_sample = task.step if task.Ts is None else task.Ts**2
        sources = (
            np.broadcast_to(task.source, F.shape),
            G @ np.swapaxes(G, -1, -2) * per_sample,
        )
        disturbance, noise = map(np.sqrt, mean_squares(F, Z, sources, task.schedule))
    if mismatch:
        F, _ = error_matrices(task.A, task.linear.C, L, Gamma, task.whole.sides)
        squares = forced_mean_square(F, Z, task.model_errors, task.S, task.starts, task.whole)
        model = np.sqrt(squares)
    return Scores(rate, disturbance, model, noise)


def certified(task: Task, L: Floats, gamma: Floats, W: Floats) -> Floats:
    """L shrunk towards 0 as far as the margin asks (b, n, p): docs/rates.md.

    1 + G - Ts gamma / 2 >= margin is linear in L, and holds at L = 0 since Ts gamma <= 1.

    Args:
        task: the design task.
        L: balanced gains (b, n, p).
        gamma: gains of the widths (b, p).
        W: storage weights (b, p).
    """
    room = 1 - task.margin - (0.0 if task.Ts is None else task.Ts / 2 * gamma)
    rows = np.sqrt(W / room)[:, None, :, None]
    columns = np.sqrt(W * room)[:, None, None, :]
    response = (task.resolvents @ L[:, None]) * rows / columns
    hermitian = (response + np.swapaxes(response, -1, -2).conj()) / 2
    if task.p == 1:
        eigenvalues: Floats = hermitian[..., 0, 0].real
    else:
        eigenvalues = np.linalg.eigvalsh(hermitian)[..., 0]
    least = eigenvalues.min(axis=1)
    return np.asarray(L * np.minimum(1.0, 1.0 / np.maximum(-least, TINY))[:, None, None])


def _slowest(task: Task, M: Floats, size: Floats) -> Floats:
    """The largest ln |multiplier| of errors that can die (b).

    Those apart that unidentifiable errors keep on the unit circle.

    Args:
        task: the design task.
        M: transition of the errors over the schedule (b, N, N), but for a factor.
        size: logarithm of that factor (b).
    """
    own = _logarithms(task.seen.T @ M @ task.seen).max(axis=-1) + size
    if not task.hidden.shape[1]:
        return own
    kept = _logarithms(task.hidden.T @ M @ task.hidden) + size[:, None]
    return np.maximum(own, np.where(np.abs(kept) < NEUTRAL, -np.inf, kept).max(axis=-1))


def _logarithms(M: Floats) -> Floats:
    """ln |eigenvalue| of matrices (b, N, N)."""
    return np.log(np.maximum(np.abs(np.linalg.eigvals(M)), TINY))
