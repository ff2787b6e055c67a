"""Gains as points of a search: a box of numbers, each of whose points is certified gains."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.support.arrays import Floats
from undeadzone.synthesis.criteria import certified, score
from undeadzone.synthesis.task import Task

REACH: Final = 5.0  # times the plant's fastest pole: the largest gains in L that are tried
SPEED: Final = (0.01, 100.0)  # gamma between these times the plant's slowest and fastest pole
NEAR_BOUND: Final = 1e-3  # share of a bound, within which a point touches it
WEIGHT: Final = 3.0  # largest logarithm of the ratio of two storage weights


class Candidate(NamedTuple):
    """Gains and what they are worth (`criteria.Scores`).

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
