"""Gains as points of a search, and what they are worth in a design task (docs/rates.md).

A search takes place in a box of numbers, each of whose points is certified gains. Their worth is
the rate, gains from disturbance, model error and noise.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.convergence import floquet
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.task import Task

REACH: Final = 5.0  # times the plant's fastest pole: the largest gains in L that are tried
SPEED: Final = (0.01, 100.0)  # gamma between these times the plant's slowest and fastest pole
NEAR_BOUND: Final = 1e-3  # share of a bound, within which a point touches it
WEIGHT: Final = 3.0  # largest logarithm of the ratio of two storage weights


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
    F, G = floquet.error_matrices(task.A, task.linear.C, L, Gamma, task.schedule.sides)
    rate = (
        -_slowest(task, *floquet.product(floquet.transitions(F, task.schedule)))
        / task.schedule.duration
    )
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
        disturbance, noise = map(np.sqrt, floquet.mean_squares(F, Z, sources, task.schedule))
    if mismatch:
        F, _ = floquet.error_matrices(task.A, task.linear.C, L, Gamma, task.whole.sides)
        squares = floquet.forced_mean_square(
            F, Z, task.model_errors, task.S, task.starts, task.whole
        )
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
    return np.asarray(L * np.minimum(1.0, 1.0 / np.maximum(-least, floquet.TINY))[:, None, None])


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
    return np.maximum(own, np.where(np.abs(kept) < floquet.NEUTRAL, -np.inf, kept).max(axis=-1))


def _logarithms(M: Floats) -> Floats:
    """ln |eigenvalue| of matrices (b, N, N)."""
    return np.log(np.maximum(np.abs(np.linalg.eigvals(M)), floquet.TINY))


class Candidate(NamedTuple):
    """Gains and what they are worth (`Scores`).

    Attributes:
        L: gain of x^ (n x p) [1/s].
        gamma: gain of the widths (p) [1/s].
        rate: of the error [1/s].
        disturbance, mismatch, noise: errors per unit of each [z].
    """

    L: Floats
    gamma: Floats
    rate: float
    disturbance: float
    mismatch: float
    noise: float


def candidate_of(task: Task, L: Floats, gamma: Floats) -> Candidate:
    """What gains L (n x p), gamma (p) [1/s] are worth in a task."""
    values = score(task, (L / task.units[:, None])[None], gamma[None])
    return Candidate(L, gamma, *(float(value[0]) for value in values))


def candidate_at(task: Task, point: Floats) -> Candidate:
    """The gains at a point (d), and what they are worth."""
    L, gamma = gains_at(task, point[None])
    return candidate_of(task, task.units[:, None] * L[0], gamma[0])


def gains_at(task: Task, points: Floats) -> tuple[Floats, Floats]:
    """The certified gains at points.

    Args:
        task: the design task.
        points: (b, d), each [asinh L / slowest pole, ln gamma, ln of all but the first storage
            weight].

    Returns:
        L, balanced (b, n, p), and gamma (b, p).
    """
    n, p = task.n, task.p
    L = task.poles.min() * np.sinh(points[:, : n * p].reshape(-1, n, p))
    gamma = np.exp(points[:, n * p : n * p + p])
    W = np.exp(np.hstack([np.zeros((len(points), 1)), points[:, n * p + p :]]))  # storage weights
    return certified(task, L, gamma, W), gamma


def point_of(task: Task, gains: Candidate) -> Floats:
    """The point whose `gains_at` these are, as near as the box allows."""
    L, gamma = gains.L / task.units[:, None], np.maximum(gains.gamma, 1e-300)
    shares = np.arcsinh(L / task.poles.min()).ravel()
    point = np.concatenate([shares, np.log(gamma), np.zeros(task.p - 1)])
    return np.clip(point, *box(task))


def box(task: Task) -> tuple[Floats, Floats]:
    """The least and greatest points of the search (d each).

    Steps of simulation and sampling bound the gains too.
    """
    slow, quick = float(task.poles.min()), float(task.poles.max())
    step = task.step if task.Ts is None else task.Ts
    reach = float(np.arcsinh(min(REACH * quick, task.room / step) / slow))
    least, greatest = np.log([SPEED[0] * slow, min(SPEED[1] * quick, task.room / step)])
    sizes = task.n * task.p, task.p, task.p - 1
    return np.repeat([-reach, least, -WEIGHT], sizes), np.repeat([reach, greatest, WEIGHT], sizes)


def touched(task: Task, point: Floats) -> str:
    """Which gains at a point (d) are the largest that the step allows to try; empty: none."""
    _, greatest = box(task)
    size = task.n * task.p
    quick, step = float(task.poles.max()), task.step if task.Ts is None else task.Ts
    at_bound = np.abs(point) > greatest - NEAR_BOUND * np.abs(greatest)
    names = []
    if at_bound[:size].any() and REACH * quick > task.room / step:
        names.append("L")
    if at_bound[size : size + task.p].any() and SPEED[1] * quick > task.room / step:
        names.append("gamma")
    return " and ".join(names)
