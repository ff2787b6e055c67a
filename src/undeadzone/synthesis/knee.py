"""The Pareto front of rate, disturbance and noise under the certificate, and its knee."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import certify
from undeadzone.linear.matrices import Matrices
from undeadzone.numerics.optimise import evolve, pareto, scalar, undominated
from undeadzone.support.arrays import Floats
from undeadzone.synthesis.candidates import (
    Candidate,
    box,
    candidate_at,
    gains_at,
    point_of,
)
from undeadzone.synthesis.criteria import score
from undeadzone.synthesis.gain_search import (
    LONG,
    RATE,
    WORSE,
    Cost,
    Synthesis,
    Tick,
    population,
    proved,
    search,
)
from undeadzone.synthesis.task import Task, watched

FLOOR: Final = 0.1  # of the best rate: slower candidates are not on the front
NEAR: Final = 0.003  # of the box: first steps of the search around present gains
ROUNDS: Final = 200  # of the search for the front
BETTER: Final = np.log(1.05)  # by which the knee should beat present gains
TRADED: Final = ("rate", "disturbance", "noise")  # on the front
FIRST: Final = 2.0  # weight of the loss by an error of the model; that of the others is 1


def balanced(
    task: Task,
    linear: Matrices,
    present: Candidate | None = None,
    seed: int = 0,
    tick: Tick | None = None,
) -> Synthesis:
    """The front of rate, disturbance and noise, and its knee.

    The knee is the point whose largest normalised loss is smallest; a loss is a logarithm between
    the least (0) and greatest (1) on the front. The error that a wrong model leaves counts too, and
    before all others: no model is exact, and gains that trust theirs look best in all else. Where
    points of the front, or of a search of its own around the present gains, beat these in rate,
    disturbance and noise, by 5 % if possible, the knee is chosen among them; where none does, a
    remark says in what the knee is worse.

    Args:
        task: the design task.
        linear: its model, not balanced.
        present: gains to beat.
        seed: of the search.
        tick: tick(1) is called STARTS + ROUNDS times.
    """
    quickest = search(task, RATE, seed, tick)
    L, gamma = gains_at(task, quickest[None])
    best_rate = score(task, L, gamma, mismatch=False, gains=False).rate[0]
    limit = float(best_rate) * FLOOR
    points, costs = _explored(task, quickest, limit, seed, tick)
    bars = [np.full(3, np.inf)]
    if present is not None:
        level = np.log([1 / max(present.rate, 1e-300), present.disturbance, present.noise])
        bars = [level - BETTER, level, *bars]
        near = _around(task, present, level, limit, seed)
        points = np.vstack([points, near])
        costs = np.vstack([costs, _costs(task, near[None], limit)])
        admitted = np.isfinite(costs).all(axis=1)
        points, costs = points[admitted], costs[admitted]
    bar = next(bar for bar in bars if (costs < bar).all(axis=1).any())
    every = np.hstack([_mismatch(task, points)[:, None], costs])
    least, greatest = every.min(axis=0), every.max(axis=0)

    def loss_in(task: Task) -> Cost:
        return _Loss(task, limit, least, greatest, bar).of

    start = points[np.argmin(loss_in(task)(points))]
    best, certificate = proved(task, linear, start, loss_in)
    remarks = () if present is None else _remarks(best, present)
    return Synthesis(best, certificate, _front(task, linear, points), remarks)


class _Loss(NamedTuple):
    """What the knee makes small: the largest loss between the ends of the front.

    Attributes:
        task: the design task.
        limit: least rate [1/s].
        least, greatest: logarithms on the front (4), that of the mismatch before the others.
        bar: logarithms to be beaten (3).
    """

    task: Task
    limit: float
    least: Floats
    greatest: Floats
    bar: Floats

    def of(self, points: Floats) -> Floats:
        """The loss of points (b, d): b numbers."""
        costs = _costs(self.task, points, self.limit)
        every = np.hstack([_mismatch(self.task, points)[:, None], costs])
        weights = np.array([[FIRST, 1.0, 1.0, 1.0]])
        loss = scalar(every, self.least, self.greatest, weights)[0]
        return np.asarray(loss + WORSE * (costs >= self.bar).any(axis=1))


def _costs(task: Task, points: Floats, limit: float) -> Floats:
    """Logarithms of 1 / rate, disturbance and noise at points (b, 3).

    They are inf where the rate is not above the limit [1/s].
    """
    L, gamma = gains_at(task, points)
    scores = score(task, L, gamma, mismatch=False)
    admitted = scores.rate > limit
    slowness = 1 / np.where(admitted, scores.rate, 1.0)
    logs = np.log(np.stack([slowness, scores.disturbance, scores.noise], axis=1))
    return np.where(admitted[:, None], logs, np.inf)


def _mismatch(task: Task, points: Floats) -> Floats:
    """Logarithms of the error per relative error of the model, at points (b, d): b numbers."""
    L, gamma = gains_at(task, points)
    return np.asarray(np.log(score(task, L, gamma, gains=False).mismatch))


def _explored(
    task: Task, quickest: Floats, limit: float, seed: int, tick: Tick | None
) -> tuple[Floats, Floats]:
    """Points (b, d) of the front and their costs (b, 3)."""

    def advance() -> None:
        if tick is not None:
            tick(1)

    return pareto(
        lambda points: _costs(task, points, limit),
        *box(task),
        seed,
        quickest[None],
        rounds=ROUNDS,
        tick=advance,
    )


def _around(task: Task, present: Candidate, level: Floats, limit: float, seed: int) -> Floats:
    """The point near present gains that beats their costs, the level (3), by most."""

    def worst(points: Floats) -> Floats:
        return np.asarray((_costs(task, points, limit) - level).max(axis=1))

    size, start = population(task), point_of(task, present)
    return evolve(worst, *box(task), seed, size, LONG, start, NEAR)[0]


def _remarks(best: Candidate, present: Candidate) -> tuple[str, ...]:
    """In what gains are worse than the present ones."""
    worse = [name for name in TRADED if not _beats(best, present, name)]
    if not worse:
        return ()
    return (
        "no certified gains were found that beat the present ones in rate, disturbance and noise "
        f"at once: these lose in {' and '.join(worse)}",
    )


def _front(task: Task, linear: Matrices, points: Floats) -> list[Candidate]:
    """The undominated of these points by falling rate.

    Their margins are made exact at their own worst frequencies.
    """
    worst = []
    for point in points:
        candidate = candidate_at(task, point)
        worst.append(certify(linear, candidate.L, candidate.gamma, task.Ts).frequency)
    task = watched(task, np.array([w for w in worst if w is not None and np.isfinite(w)]))
    candidates = [candidate_at(task, point) for point in points]
    candidates.sort(key=lambda one: -one.rate)
    keep = undominated(np.array([[-one.rate, one.disturbance, one.noise] for one in candidates]))
    return [one for one, kept in zip(candidates, keep, strict=True) if kept]


def _beats(one: Candidate, other: Candidate, name: str) -> bool:
    """Whether one candidate is better than another in rate, disturbance or noise."""
    sign = 1 if name == "rate" else -1
    return bool(sign * getattr(one, name) > sign * getattr(other, name))
