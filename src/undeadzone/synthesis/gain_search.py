"""Gains L, gamma by optimisation under the certificate: the fastest, a weighted trade, or a Pareto front and its knee.

Every candidate is certified by construction (`task.certified`), so that the search is free; the result is proved anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.linear.matrices import Matrices
from undeadzone.numerics.optimise import evolve, pareto, scalar, undominated
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.criteria import Task, certified, score, watched

FLOOR = 0.1  # of the best rate: slower candidates are not on the front
REACH = 5.0  # times the plant's fastest pole: the largest gains in L that are tried
SPEED = (0.01, 100.0)  # gamma between these times the plant's slowest and fastest pole
WEIGHT = 3.0  # largest logarithm of the ratio of two storage weights
STARTS = 10  # short searches for the fastest; the best of them is continued
NEAR = 0.003  # of the box: first steps of the search around present gains
SHORT, LONG = 60, 250  # rounds of the short searches and of the long one
ROUNDS = 200  # of the search for the front
BETTER = np.log(1.05)  # by which the knee should beat present gains
WORSE = 1e3  # cost of a candidate whose error does not die


class Weights(NamedTuple):
    """The trade to maximise: rate / (disturbance^a mismatch^b noise^c)."""

    disturbance: float = 0.0
    mismatch: float = 0.0
    noise: float = 0.0


RATE = Weights()


class Candidate(NamedTuple):
    """Gains L (n x p), gamma (p) [1/s] and what they are worth (`task.Scores`)."""

    L: Floats
    gamma: Floats
    rate: float
    disturbance: float
    mismatch: float
    noise: float


class Synthesis(NamedTuple):
    """The chosen gains and their proof; the front (by falling rate; the choice alone if no front was asked); remarks."""

    best: Candidate
    certificate: Certificate
    front: list[Candidate]
    remarks: tuple[str, ...]


Tick = Callable[[int], None]


def fastest(
    task: Task, linear: Matrices, weights: Weights = RATE, seed: int = 0, tick: Tick | None = None
) -> Synthesis:
    """The certified gains of the largest rate, or of the best trade that `weights` name; tick(1) is called STARTS times."""
    best, certificate = _proved(
        task, linear, _search(task, weights, seed, tick), lambda task: _cost(task, weights)
    )
    return Synthesis(best, certificate, [best], ())


def balanced(
    task: Task,
    linear: Matrices,
    present: Candidate | None = None,
    seed: int = 0,
    tick: Tick | None = None,
) -> Synthesis:
    """The front of rate, disturbance and noise, and its knee: the point whose largest normalised loss is smallest.

    A loss is a logarithm between the least (0) and greatest (1) on the front. Where points of the front, or of a search
    of its own around the `present` gains, beat these in all three, by 5 % if possible, the knee is chosen among them;
    where none does, a remark says in what the knee is worse. tick(1) is called STARTS + ROUNDS times.
    """
    quickest = _search(task, RATE, seed, tick)
    limit = (
        float(score(task, *_gains(task, quickest[None]), mismatch=False, gains=False).rate[0])
        * FLOOR
    )

    def costs(task: Task, points: Floats) -> Floats:
        L, gamma = _gains(task, points)
        found = score(task, L, gamma, mismatch=False)
        admitted = found.rate > limit
        logs = np.log(
            np.stack(
                [1 / np.where(admitted, found.rate, 1.0), found.disturbance, found.noise], axis=1
            )
        )
        return np.where(admitted[:, None], logs, np.inf)

    points, found = pareto(
        lambda x: costs(task, x),
        *_box(task),
        seed,
        quickest[None],
        rounds=ROUNDS,
        tick=lambda: tick(1) if tick else None,
    )
    bars = [np.full(3, np.inf)]
    if present is not None:
        level = np.log([1 / max(present.rate, 1e-300), present.disturbance, present.noise])
        bars = [level - BETTER, level, *bars]
        near = evolve(
            lambda x: (costs(task, x) - level).max(axis=1),
            *_box(task),
            seed,
            _population(task),
            LONG,
            _point(task, present),
            NEAR,
        )[0]
        points, found = np.vstack([points, near]), np.vstack([found, costs(task, near[None])])
        admitted = np.isfinite(found).all(axis=1)
        points, found = points[admitted], found[admitted]
    frame = found.min(axis=0), found.max(axis=0)
    bar = next(bar for bar in bars if (found < bar).all(axis=1).any())

    def loss(task: Task) -> Callable[[Floats], Floats]:
        def cost(points: Floats) -> Floats:
            given = costs(task, points)
            return np.asarray(
                scalar(given, *frame, np.ones((1, 3)))[0] + WORSE * (given >= bar).any(axis=1)
            )

        return cost

    start = points[np.argmin(loss(task)(points))]
    best, certificate = _proved(task, linear, start, loss)
    remarks = []
    if present is not None and (
        worse := [
            name for name in ("rate", "disturbance", "noise") if not _beats(best, present, name)
        ]
    ):
        remarks.append(
            f"no certified gains were found that beat the present ones in rate, disturbance and noise at once: these lose in {' and '.join(worse)}"
        )
    return Synthesis(best, certificate, _front(task, linear, points), tuple(remarks))


def _front(task: Task, linear: Matrices, points: Floats) -> list[Candidate]:
    """The undominated of these points by falling rate, their margins made exact at their own worst frequencies."""
    candidates = [_candidate(task, point) for point in points]
    worst = [certify(linear, one.L, one.gamma, task.Ts).frequency for one in candidates]
    task = watched(task, np.array([w for w in worst if w is not None and np.isfinite(w)]))
    candidates = sorted((_candidate(task, point) for point in points), key=lambda one: -one.rate)
    keep = undominated(np.array([[-one.rate, one.disturbance, one.noise] for one in candidates]))
    return [one for one, kept in zip(candidates, keep, strict=True) if kept]


def _beats(one: Candidate, other: Candidate, name: str) -> bool:
    sign = 1 if name == "rate" else -1
    return bool(sign * getattr(one, name) > sign * getattr(other, name))


def candidate_of(task: Task, L: Floats, gamma: Floats) -> Candidate:
    """What gains L (n x p), gamma (p) [1/s] are worth in a task."""
    values = score(task, (L / task.units[:, None])[None], gamma[None])
    return Candidate(L, gamma, *(float(value[0]) for value in values))


def _search(task: Task, weights: Weights, seed: int, tick: Tick | None) -> Floats:
    """The best of several seeded searches, before it is polished."""
    low, high = _box(task)
    cost, size = _cost(task, weights), _population(task)
    found = []
    for start in range(STARTS):
        found.append(evolve(cost, low, high, seed * STARTS + start, size, SHORT))
        if tick is not None:
            tick(1)
    return evolve(cost, low, high, seed, size, LONG, min(found, key=lambda pair: pair[1])[0])[0]


def _cost(task: Task, weights: Weights) -> Callable[[Floats], Floats]:
    def cost(points: Floats) -> Floats:
        L, gamma = _gains(task, points)
        found = score(
            task,
            L,
            gamma,
            mismatch=weights.mismatch > 0,
            gains=weights.disturbance > 0 or weights.noise > 0,
        )
        total = -np.log(np.maximum(found.rate, 1e-300))
        for name, weight in weights._asdict().items():
            if weight:
                total = total + weight * np.log(getattr(found, name))
        return np.where(found.rate > 0, total, WORSE - found.rate)

    return cost


def _proved(
    task: Task, linear: Matrices, point: Floats, cost: Callable[[Task], Callable[[Floats], Floats]]
) -> tuple[Candidate, Certificate]:
    """The point polished by Nelder and Mead's method and proved; where the exact margin is missed, its frequency is watched too."""
    from scipy.optimize import minimize

    low, high = _box(task)
    for _ in range(5):
        here = cost(task)
        options = {
            "maxfev": 150 * point.size,
            "xatol": 1e-9,
            "fatol": 1e-12,
            "adaptive": point.size > 4,
        }
        point = minimize(
            lambda x: float(here(np.clip(x, low, high)[None])[0]),
            point,
            method="Nelder-Mead",
            options=options,
        ).x.clip(low, high)
        candidate = _candidate(task, point)
        certificate = certify(linear, candidate.L, candidate.gamma, task.Ts)
        if certificate.certified and certificate.margin > task.margin * (1 - 1e-6):
            return candidate, certificate
        if certificate.frequency is not None:
            task = watched(task, np.array([certificate.frequency]))
    while not (certificate.certified and certificate.margin > task.margin * (1 - 1e-6)):
        candidate = candidate_of(task, 0.99 * candidate.L, candidate.gamma)
        certificate = certify(linear, candidate.L, candidate.gamma, task.Ts)
    return candidate, certificate


def _candidate(task: Task, point: Floats) -> Candidate:
    L, gamma = _gains(task, point[None])
    return candidate_of(task, task.units[:, None] * L[0], gamma[0])


def _gains(task: Task, points: Floats) -> tuple[Floats, Floats]:
    """(L balanced, gamma) of points (b, d) = [asinh L / slowest pole, ln gamma, ln of all but the first storage weight]."""
    n, p = task.n, task.p
    L = task.poles.min() * np.sinh(points[:, : n * p].reshape(-1, n, p))
    gamma = np.exp(points[:, n * p : n * p + p])
    W = np.exp(np.hstack([np.zeros((len(points), 1)), points[:, n * p + p :]]))
    return certified(task, L, gamma, W), gamma


def _point(task: Task, gains: Candidate) -> Floats:
    """The point whose `_gains` these are, as near as the box allows."""
    L, gamma = gains.L / task.units[:, None], np.maximum(gains.gamma, 1e-300)
    return np.clip(
        np.concatenate(
            [np.arcsinh(L / task.poles.min()).ravel(), np.log(gamma), np.zeros(task.p - 1)]
        ),
        *_box(task),
    )


def _population(task: Task) -> int:
    return 32 if _box(task)[0].size < 8 else 64


def _box(task: Task) -> tuple[Floats, Floats]:
    """The least and greatest points of the search; steps of simulation and sampling bound the gains too."""
    slow, quick = float(task.poles.min()), float(task.poles.max())
    step = task.step if task.Ts is None else task.Ts
    reach = float(np.arcsinh(min(REACH * quick, 0.5 / step) / slow))
    least, greatest = np.log([SPEED[0] * slow, min(SPEED[1] * quick, 0.5 / step)])
    sizes = task.n * task.p, task.p, task.p - 1
    return np.repeat([-reach, least, -WEIGHT], sizes), np.repeat([reach, greatest, WEIGHT], sizes)
