"""Gains L, gamma by optimisation under the certificate: the fastest, a weighted trade, the knee.

Every candidate is certified by construction (`candidates.certified`), so that the search is free.
The result is proved anew. The knee is that of the Pareto front of rate, disturbance and noise.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from undeadzone.analysis.certificate.passivity import Certificate, certify
from undeadzone.numerics.optimise import (
    find_pareto_front,
    is_undominated,
    minimise_by_cmaes,
    scalar_costs,
)
from undeadzone.util.arrays import Floats
from undeadzone_design.synthesis.task import (
    Candidate,
    Scores,
    Task,
    add_frequencies,
    list_gains_at_limit,
    score_candidate,
    score_gains,
    score_point,
    search_box,
    to_certified_gains,
    to_search_point,
)

STARTS: Final = 10  # short searches for the fastest; the best of them is continued
SHORT: Final = 60  # rounds of each short search
LONG: Final = 250  # rounds of each of the long ones, the second with steps of NEAR of the box
NEAR: Final = 0.003
MOST: Final = 1.5  # gains per step beyond which none are tried
WORSE: Final = 1e3  # cost of a candidate whose error does not die
POLISHED: Final = 5  # times that the result is polished before its gains are shrunk instead
SHRINK: Final = 0.99  # factor on L until the exact margin is met
ROUNDING: Final = 1e-6  # relative, of a margin
FLOOR: Final = 0.1  # of the best rate: slower candidates are not on the front
ROUNDS: Final = 200  # of the search for the front
BETTER: Final = np.log(1.05)  # by which the knee should beat present gains
TRADED: Final = ("rate", "disturbance", "noise")  # on the front
FIRST: Final = 2.0  # weight of the loss by an error of the model; that of the others is 1


class Weights(NamedTuple):
    """Trade to maximise: rate / (disturbance^a mismatch^b noise^c).

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
    """Result of a search of gains.

    Attributes:
        best: the chosen gains.
        certificate: their proof.
        front: the trade-off, by falling rate, the choice alone if no front was computed.
        remarks: what could not be had.
    """

    best: Candidate
    certificate: Certificate
    front: list[Candidate]
    remarks: tuple[str, ...]


Tick = Callable[[int], None]
Cost = Callable[[Floats], Floats]  # of points (b, d): numbers (b)


def find_fastest(task: Task, weights: Weights, seed: int, tick: Tick) -> Synthesis:
    """Return the certified gains of the largest rate, or of the best trade that `weights`
    name.

    Args:
        task: the design task.
        weights: the trade.
        seed: of the search.
        tick: tick(1) is called STARTS times.
    """
    task, start = search_seeded(task, weights, seed, tick)
    best, certificate = polish_and_prove(task, start, partial(_build_trade_cost, weights=weights))
    return Synthesis(best, certificate, [best], describe_gain_limit(task, best))


def describe_gain_limit(task: Task, best: Candidate) -> tuple[str, ...]:
    """Return the remark that the step kept a search from larger gains, or no remark."""
    names = list_gains_at_limit(task, to_search_point(task, best))
    if not names:
        return ()
    return (
        f"{names} touches the largest gain that the step allows to try, {task.room:g} per step: "
        "with a shorter simulation.step there may be better gains",
    )


def search_seeded(task: Task, weights: Weights, seed: int, tick: Tick) -> tuple[Task, Floats]:
    """Return the best point of the search box from several seeded searches, and its task.

    If the point touches the largest gains that are tried, larger ones are tried too.

    Args:
        task: the plant and the limits of its gains.
        weights: of the objectives.
        seed: of the searches.
        tick: called with 1 after each short search.

    Returns:
        The task with the limit it ended at, and the point (d), see `to_certified_gains`.
    """
    low, high = search_box(task)
    cost = _build_trade_cost(task, weights)
    size = search_population(task)
    best = low
    least = np.inf
    for start in range(STARTS):
        point, value = minimise_by_cmaes(cost, low, high, seed * STARTS + start, size, SHORT)
        if start == 0 or value < least:
            best = point
            least = value
        tick(1)
    best = _choose_cheaper(
        cost, best, minimise_by_cmaes(cost, low, high, seed, size, LONG, best)[0]
    )
    while True:
        low, high = search_box(task)
        best = _choose_cheaper(
            cost, best, minimise_by_cmaes(cost, low, high, seed, size, LONG, best, NEAR)[0]
        )
        if task.room >= MOST or not list_gains_at_limit(task, best):
            return task, best
        task = task._replace(room=min(2 * task.room, MOST))


def _choose_cheaper(cost: Cost, one: Floats, other: Floats) -> Floats:
    """Return the point of less cost (d each)."""
    return (one, other)[int(np.argmin(cost(np.stack([one, other]))))]


def _build_trade_cost(task: Task, weights: Weights) -> Cost:
    """Return the function that the best trade minimises."""
    mismatch = weights.mismatch > 0
    gains = weights.disturbance > 0 or weights.noise > 0

    def cost(points: Floats) -> Floats:
        """Return the cost of points (b)."""
        L, gamma = to_certified_gains(task, points)
        scores = score_gains(task, L, gamma, mismatch=mismatch, gains=gains)
        total = -np.log(np.maximum(scores.rate, 1e-300))
        for name, weight in weights._asdict().items():
            if weight:
                total = total + weight * np.log(getattr(scores, name))
        return np.where(scores.rate > 0, total, WORSE - scores.rate)

    return cost


def polish_and_prove(
    task: Task, point: Floats, cost_in: Callable[[Task], Cost]
) -> tuple[Candidate, Certificate]:
    """Return the polished point with its certificate.

    If the exact margin is missed, its frequency is watched too.

    Args:
        task: the design task.
        point: to start from (d).
        cost_in: cost_in(task) is the cost to minimise.
    """
    enough = task.margin * (1 - ROUNDING)
    for _ in range(POLISHED):
        point = _polish_by_simplex(cost_in(task), point, *search_box(task))
        candidate = score_point(task, point)
        certificate = certify(task.model, candidate.L, candidate.gamma, task.Ts)
        if certificate.certified and certificate.margin > enough:
            return candidate, certificate
        if certificate.frequency is not None:
            task = add_frequencies(task, np.array([certificate.frequency]))
    while not (certificate.certified and certificate.margin > enough):
        candidate = score_candidate(task, SHRINK * candidate.L, candidate.gamma)
        certificate = certify(task.model, candidate.L, candidate.gamma, task.Ts)
    return candidate, certificate


def _polish_by_simplex(cost: Cost, point: Floats, low: Floats, high: Floats) -> Floats:
    """Return a point of less cost between bounds (d each), by Nelder and Mead's method."""
    from scipy.optimize import minimize

    def cost_of_one(x: Floats) -> float:
        """Return the cost of a single point (d)."""
        return float(cost(np.clip(x, low, high)[None])[0])

    n = point.size
    options = {"maxfev": 150 * n, "xatol": 1e-9, "fatol": 1e-12, "adaptive": n > 4}
    result = minimize(cost_of_one, point, method="Nelder-Mead", options=options)
    return np.asarray(result.x.clip(low, high))


def search_population(task: Task) -> int:
    """Return the number of points that a round of the search evaluates."""
    return 32 if search_box(task)[0].size < 8 else 64


def find_balanced(task: Task, present: Candidate | None, seed: int, tick: Tick) -> Synthesis:
    """Return the front of rate, disturbance and noise, and its knee.

    The knee is the point whose largest normalised loss is smallest. A loss is a logarithm between
    the least (0) and greatest (1) on the front. The error that a wrong model leaves counts too, and
    before all others: no model is exact, and gains that trust theirs look best in all else. If
    points of the front, or of a search of its own around the present gains, beat these in rate,
    disturbance and noise, by 5 % if possible, the knee is chosen among them. If none does, a remark
    names the scores in which the knee is worse.

    Args:
        task: the design task.
        present: gains to beat (None: there are none).
        seed: of the search.
        tick: tick(1) is called STARTS + ROUNDS times.
    """
    task, quickest = search_seeded(task, RATE, seed, tick)
    quick = score_gains(
        task, *to_certified_gains(task, quickest[None]), mismatch=False, gains=False
    )
    limit = float(quick.rate[0]) * FLOOR
    traded = partial(_pareto_costs, task, limit=limit)
    advance = partial(tick, 1)
    points, costs = find_pareto_front(
        traded, *search_box(task), seed, quickest[None], rounds=ROUNDS, tick=advance
    )
    bars = [np.full(3, np.inf)]
    if present is not None:
        level = np.log([1 / max(present.rate, 1e-300), present.disturbance, present.noise])
        bars = [level - BETTER, level, *bars]
        near = _search_near_present(task, present, level, limit, seed)
        points = np.vstack([points, near])
        costs = np.vstack([costs, traded(near[None])])
        admitted = np.isfinite(costs).all(axis=1)
        points = points[admitted]
        costs = costs[admitted]
    bar = next(bar for bar in bars if (costs < bar).all(axis=1).any())
    mismatch = score_gains(task, *to_certified_gains(task, points), gains=False).mismatch
    every = np.hstack([np.log(mismatch)[:, None], costs])
    least = every.min(axis=0)
    greatest = every.max(axis=0)
    loss_in = partial(_build_knee_loss, limit=limit, least=least, greatest=greatest, bar=bar)
    start = points[np.argmin(loss_in(task)(points))]
    best, certificate = polish_and_prove(task, start, loss_in)
    remarks = describe_gain_limit(task, best)
    if present is not None:
        remarks += _list_remarks(best, present)
    return Synthesis(best, certificate, _collect_front(task, points), remarks)


def _build_knee_loss(
    task: Task, limit: float, least: Floats, greatest: Floats, bar: Floats
) -> Cost:
    """Return the function that the knee minimises: the largest loss between the ends of the
    front.

    Args:
        task: the design task.
        limit: least rate [1/s].
        least, greatest: logarithms on the front (4), that of the mismatch before the others.
        bar: logarithms to be beaten (3).
    """

    def loss(points: Floats) -> Floats:
        """Return the loss of points (b)."""
        scores = score_gains(task, *to_certified_gains(task, points))
        costs = _log_objectives(scores, limit)
        every = np.hstack([np.log(scores.mismatch)[:, None], costs])
        weights = np.array([[FIRST, 1.0, 1.0, 1.0]])
        largest = scalar_costs(every, least, greatest, weights)[0]
        return np.asarray(largest + WORSE * (costs >= bar).any(axis=1))

    return loss


def _pareto_costs(task: Task, points: Floats, limit: float) -> Floats:
    """Return the costs of points (b, d), see `TRADED`."""
    return _log_objectives(
        score_gains(task, *to_certified_gains(task, points), mismatch=False), limit
    )


def _log_objectives(scores: Scores, limit: float) -> Floats:
    """Return logarithms of 1 / rate, disturbance and noise (b, 3).

    They are inf if the rate is not above the limit [1/s].
    """
    admitted = scores.rate > limit
    slowness = 1 / np.where(admitted, scores.rate, 1.0)
    logs = np.log(np.stack([slowness, scores.disturbance, scores.noise], axis=1))
    return np.where(admitted[:, None], logs, np.inf)


def _search_near_present(
    task: Task, present: Candidate, level: Floats, limit: float, seed: int
) -> Floats:
    """Return the point near present gains that improves most on their costs, the level (3)."""

    def worst(points: Floats) -> Floats:
        """Return the largest excess of points over the level (b)."""
        return np.asarray((_pareto_costs(task, points, limit) - level).max(axis=1))

    size = search_population(task)
    start = to_search_point(task, present)
    return minimise_by_cmaes(worst, *search_box(task), seed, size, LONG, start, NEAR)[0]


def _list_remarks(best: Candidate, present: Candidate) -> tuple[str, ...]:
    """Return remarks on the objectives in which gains are worse than the present gains."""
    pairs = zip(TRADED, _to_objectives(best), _to_objectives(present), strict=True)
    worse = [name for name, here, before in pairs if not here < before]
    if not worse:
        return ()
    return (
        "no certified gains were found that beat the present ones in rate, disturbance and noise "
        f"at once: these lose in {' and '.join(worse)}",
    )


def _collect_front(task: Task, points: Floats) -> list[Candidate]:
    """Return the undominated points by falling rate.

    Their margins are made exact at their own worst frequencies.
    """
    worst = []
    for point in points:
        candidate = score_point(task, point)
        worst.append(certify(task.model, candidate.L, candidate.gamma, task.Ts).frequency)
    task = add_frequencies(task, np.array([w for w in worst if w is not None and np.isfinite(w)]))
    candidates = [score_point(task, point) for point in points]
    candidates.sort(key=lambda one: -one.rate)
    keep = is_undominated(np.array(list(map(_to_objectives, candidates))))
    return [one for one, undominated in zip(candidates, keep, strict=True) if undominated]


def _to_objectives(one: Candidate) -> tuple[float, float, float]:
    """Return the objectives `TRADED` of a candidate, each the better the smaller it is."""
    return -one.rate, one.disturbance, one.noise
