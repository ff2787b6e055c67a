"""Seeded search for minima of functions without useful gradients, many points per call: one objective, or a Pareto front."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from undeadzone.support.arrays import Floats

NEIGHBOURS = 12  # weights that share their solutions
TILT = 0.05  # part of the sum in the scalar cost, so that no objective is neglected where another one binds


def evolve(
    cost: Callable[[Floats], Floats],
    low: Floats,
    high: Floats,
    seed: int,
    size: int,
    rounds: int,
    start: Floats | None = None,
    spread: float = 0.05,
) -> tuple[Floats, float]:
    """(x, cost) of the least cost found in the box by CMA-ES, Hansen and Ostermeier (2001); cost takes (size, d) and gives (size).

    From a random point with wide steps, or from `start` with steps of `spread` of the box.
    """
    from cmaes import CMA

    d, span = low.size, high - low
    mean, sigma = (
        (np.random.default_rng(seed).uniform(0.2, 0.8, d), 0.3)
        if start is None
        else ((start - low) / span, spread)
    )
    search = CMA(mean=mean, sigma=sigma, seed=seed, population_size=size)
    best, least = mean, np.inf
    for _ in range(rounds):
        points = np.stack([search.ask() for _ in range(size)])
        inside = np.clip(points, 0.0, 1.0)
        found = np.nan_to_num(cost(low + inside * span), posinf=1e300)
        if found.min() < least:
            best, least = inside[found.argmin()], float(found.min())
        outside = (1 + abs(least)) * ((points - inside) ** 2).sum(axis=1)
        search.tell(list(zip(points, (found + outside).tolist(), strict=True)))
        if search.should_stop():
            break
    return low + best * span, least


def pareto(
    costs: Callable[[Floats], Floats],
    low: Floats,
    high: Floats,
    seed: int,
    starts: Floats,
    divisions: int = 10,
    rounds: int = 120,
    tick: Callable[[], None] = lambda: None,
) -> tuple[Floats, Floats]:
    """(points, costs) of a Pareto front of k objectives, by decomposition: MOEA/D with differential evolution, Li and Zhang (2009).

    costs takes (b, d) and gives (b, k), inf where a point is not admitted; starts (s, d) are points to begin from. Each
    weight on a grid of that many divisions minimises the largest weighted loss, normalised between the least and greatest
    costs on the front. tick is called after each round.
    """
    rng = np.random.default_rng(seed)
    d, span = low.size, high - low
    points = np.vstack([starts, low + span * rng.uniform(size=(600, d))])
    found = costs(points)
    weights = np.maximum(_grid(found.shape[1], divisions), 1e-3)
    size, every = len(weights), np.arange(len(weights))
    near = np.argsort(((weights[:, None] - weights) ** 2).sum(axis=2), axis=1)[:, :NEIGHBOURS]
    mates = near.shape[1]
    frame = _frame(found)
    first = scalar(found, *frame, weights).argmin(axis=1)
    points, found = points[first], found[first]
    for turn in range(rounds):
        one, two = (
            np.where(
                rng.uniform(size=size) < 0.1,
                rng.integers(0, size, size),
                near[every, rng.integers(0, mates, size)],
            )
            for _ in range(2)
        )
        children = np.where(
            rng.uniform(size=(size, d)) < (0.9 if d < 5 else 0.5),
            points + 0.6 * (points[one] - points[two]),
            points,
        )
        jump = (
            (rng.uniform(size=(size, d)) < 1 / d)
            * rng.normal(size=(size, d))
            * rng.uniform(size=(size, 1)) ** 3
        )
        children = np.clip(children + 0.03 * span * jump, low, high)
        given = costs(children)
        if turn % 5 == 0:
            frame = _frame(np.vstack([found, given]))
        offers = np.full((size, size), np.inf)
        np.put_along_axis(
            offers, near, np.take_along_axis(scalar(given, *frame, weights), near, axis=1), axis=1
        )
        best = offers.argmin(axis=1)
        better = offers[every, best] < scalar(found, *frame, weights)[every, every]
        points, found = (
            np.where(better[:, None], children[best], points),
            np.where(better[:, None], given[best], found),
        )
        tick()
    keep = undominated(found) & np.isfinite(found).all(axis=1)
    keep[keep] = np.isin(
        np.arange(keep.sum()), np.unique(found[keep].round(9), axis=0, return_index=True)[1]
    )
    return points[keep], found[keep]


def scalar(found: Floats, least: Floats, greatest: Floats, weights: Floats) -> Floats:
    """The scalar cost (w, b) of each of b points under each of w weights: the largest weighted loss, tilted by the sum."""
    loss = weights[:, None] * ((found - least) / np.maximum(greatest - least, 1e-9))
    return np.asarray(loss.max(axis=2) + TILT * loss.sum(axis=2))


def undominated(found: Floats) -> Floats:
    """Which points (b, k) no other one beats in all costs."""
    worse = (found[:, None] >= found).all(axis=2) & (found[:, None] > found).any(axis=2)
    return ~np.any(worse, axis=1)


def _frame(found: Floats) -> tuple[Floats, Floats]:
    """Least and greatest costs on the front of the points found so far."""
    found = found[np.isfinite(found).all(axis=1)]
    front = found[undominated(found)]
    return front.min(axis=0), front.max(axis=0)


def _grid(k: int, divisions: int) -> Floats:
    """All k-tuples of multiples of 1 / divisions that add up to 1."""
    return (
        np.array(
            [
                parts
                for parts in itertools.product(range(divisions + 1), repeat=k)
                if sum(parts) == divisions
            ]
        )
        / divisions
    )
