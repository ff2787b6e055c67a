"""Gains L, gamma by optimisation under the certificate: the fastest, or a weighted trade.

Every candidate is certified by construction (`criteria.certified`), so that the search is free; the
result is proved anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.linear.matrices import Matrices
from undeadzone.numerics.optimise import evolve
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.candidates import (
    Candidate,
    box,
    candidate_at,
    candidate_of,
    gains_at,
    point_of,
    touched,
)
from undeadzone.synthesis.criteria import score
from undeadzone.synthesis.task import Task, watched

STARTS: Final = 10  # short searches for the fastest; the best of them is continued
SHORT: Final = 60  # rounds of each short search
LONG: Final = 250  # rounds of each of the long ones, the second with steps of NEAR of the box
NEAR: Final = 0.003
MOST: Final = 1.5  # gains per step beyond which none are tried
WORSE: Final = 1e3  # cost of a candidate whose error does not die
POLISHED: Final = 5  # times that the result is polished before its gains are shrunk instead
SHRINK: Final = 0.99  # factor on L until the exact margin is met
ROUNDING: Final = 1e-6  # relative, of a margin


class Weights(NamedTuple):
    """The trade to maximise: rate / (disturbance^a mismatch^b noise^c).

    Attributes:
        disturbance: its exponent a.
        mismatch: its exponent b.
        noise: its exponent c.
    """

    disturbance: float = 0.0
    mismatch: float = 0.0
    noise: float = 0.0


RATE: Final = Weights()


class Synthesis(NamedTuple):
    """What a search found.

    Attributes:
        best: the chosen gains.
        certificate: their proof.
        front: the trade, by falling rate; the choice alone if no front was asked for.
        remarks: what could not be had.
    """

    best: Candidate
    certificate: Certificate
    front: list[Candidate]
    remarks: tuple[str, ...]


Tick = Callable[[int], None]
Cost = Callable[[Floats], Floats]  # of points (b, d): numbers (b)


def fastest(
    task: Task, linear: Matrices, weights: Weights = RATE, seed: int = 0, tick: Tick | None = None
) -> Synthesis:
    """The certified gains of the largest rate, or of the best trade that `weights` name.

    Args:
        task: the design task.
        linear: its model, not balanced.
        weights: the trade.
        seed: of the search.
        tick: tick(1) is called STARTS times.
    """

    def cost_in(task: Task) -> Cost:
        return _cost(task, weights)

    task, start = search(task, weights, seed, tick)
    best, certificate = proved(task, linear, start, cost_in)
    return Synthesis(best, certificate, [best], at_the_limit(task, best))


def at_the_limit(task: Task, best: Candidate) -> tuple[str, ...]:
    """That the step kept a search from larger gains, if it did."""
    names = touched(task, point_of(task, best))
    if not names:
        return ()
    return (
        f"{names} touches the largest gain that the step allows to try, {task.room:g} per step: "
        "with a shorter simulation.step there may be better gains",
    )


def search(task: Task, weights: Weights, seed: int, tick: Tick | None) -> tuple[Task, Floats]:
    """The best of several seeded searches, before it is polished, and the task it was found in.

    Where it touches the largest gains that are tried, larger ones are tried too.
    """
    low, high = box(task)
    cost, size = _cost(task, weights), population(task)
    best, least = low, np.inf
    for start in range(STARTS):
        point, value = evolve(cost, low, high, seed * STARTS + start, size, SHORT)
        if start == 0 or value < least:
            best, least = point, value
        if tick is not None:
            tick(1)
    best = _better(cost, best, evolve(cost, low, high, seed, size, LONG, best)[0])
    while True:
        low, high = box(task)
        best = _better(cost, best, evolve(cost, low, high, seed, size, LONG, best, NEAR)[0])
        if task.room >= MOST or not touched(task, best):
            return task, best
        task = task._replace(room=min(2 * task.room, MOST))


def _better(cost: Cost, one: Floats, other: Floats) -> Floats:
    """The point of less cost (d each)."""
    return (one, other)[int(np.argmin(cost(np.stack([one, other]))))]


def _cost(task: Task, weights: Weights) -> Cost:
    """The function that the best trade makes small."""
    mismatch = weights.mismatch > 0
    gains = weights.disturbance > 0 or weights.noise > 0

    def cost(points: Floats) -> Floats:
        L, gamma = gains_at(task, points)
        scores = score(task, L, gamma, mismatch=mismatch, gains=gains)
        total = -np.log(np.maximum(scores.rate, 1e-300))
        for name, weight in weights._asdict().items():
            if weight:
                total = total + weight * np.log(getattr(scores, name))
        return np.where(scores.rate > 0, total, WORSE - scores.rate)

    return cost


def proved(
    task: Task, linear: Matrices, point: Floats, cost_in: Callable[[Task], Cost]
) -> tuple[Candidate, Certificate]:
    """The point polished and proved.

    Where the exact margin is missed, its frequency is watched too.

    Args:
        task: the design task.
        linear: its model, not balanced.
        point: to start from (d).
        cost_in: cost_in(task) is what is made small.
    """
    enough = task.margin * (1 - ROUNDING)
    for _ in range(POLISHED):
        point = _polished(cost_in(task), point, *box(task))
        candidate = candidate_at(task, point)
        certificate = certify(linear, candidate.L, candidate.gamma, task.Ts)
        if certificate.certified and certificate.margin > enough:
            return candidate, certificate
        if certificate.frequency is not None:
            task = watched(task, np.array([certificate.frequency]))
    while not (certificate.certified and certificate.margin > enough):
        candidate = candidate_of(task, SHRINK * candidate.L, candidate.gamma)
        certificate = certify(linear, candidate.L, candidate.gamma, task.Ts)
    return candidate, certificate


def _polished(cost: Cost, point: Floats, low: Floats, high: Floats) -> Floats:
    """A point of less cost between bounds (d each), by Nelder and Mead's method."""
    from scipy.optimize import minimize

    def cost_of_one(x: Floats) -> float:
        return float(cost(np.clip(x, low, high)[None])[0])

    options = {
        "maxfev": 150 * point.size,
        "xatol": 1e-9,
        "fatol": 1e-12,
        "adaptive": point.size > 4,
    }
    result = minimize(cost_of_one, point, method="Nelder-Mead", options=options)
    return np.asarray(result.x.clip(low, high))


def population(task: Task) -> int:
    """How many points a round of the search tries."""
    return 32 if box(task)[0].size < 8 else 64
