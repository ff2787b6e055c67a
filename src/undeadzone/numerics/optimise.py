"""Seeded search for minima of functions without useful gradients, with many points per call.

`minimise_by_cmaes` minimises one objective. `find_pareto_front` finds the trade-off between
several.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from undeadzone.util.arrays import Floats, Integers

SAMPLES = 600  # random points from which a Pareto front begins, besides those that the caller gives
NEIGHBOURS = 12  # weights that share their solutions
# Part of the sum in the scalar cost, so that no objective is neglected where another one binds.
TILT = 0.05


def minimise_by_cmaes(
    cost: Callable[[Floats], Floats],
    low: Floats,
    high: Floats,
    seed: int,
    size: int,
    rounds: int,
    start: Floats | None = None,
    spread: float = 0.05,
) -> tuple[Floats, float]:
    """Return the point of least cost found in a box by CMA-ES, Hansen and Ostermeier (2001).

    References:
        N. Hansen, A. Ostermeier (2001), doi:10.1162/106365601750190398

    Args:
        cost: takes points (size, d) and gives their costs (size).
        low, high: the corners of the box (d).
        seed: of the random numbers.
        size: points per round.
        rounds: at most.
        start: the point to begin from (d) (default: a random one, with wide steps).
        spread: the first steps from `start`, as a part of the box.

    Returns:
        The point x (d) and its cost.
    """
    from cmaes import CMA

    span = high - low
    if start is None:
        mean = np.random.default_rng(seed).uniform(0.2, 0.8, low.size)
        sigma = 0.3
    else:
        mean = (start - low) / span
        sigma = spread
    search = CMA(mean=mean, sigma=sigma, seed=seed % 2**32, population_size=size)
    best = mean
    least = np.inf
    for _ in range(rounds):
        points = np.stack([search.ask() for _ in range(size)])
        inside = np.clip(points, 0.0, 1.0)
        values = np.nan_to_num(cost(low + inside * span), posinf=1e300)
        if values.min() < least:
            best = inside[values.argmin()]
            least = float(values.min())
        outside = (1 + abs(least)) * ((points - inside) ** 2).sum(axis=1)
        penalised = (values + outside).tolist()
        search.tell(list(zip(points, penalised, strict=True)))
        if search.should_stop():
            break
    return low + best * span, least


def find_pareto_front(
    costs: Callable[[Floats], Floats],
    low: Floats,
    high: Floats,
    seed: int,
    starts: Floats,
    divisions: int = 10,
    rounds: int = 120,
    tick: Callable[[], None] = lambda: None,
) -> tuple[Floats, Floats]:
    """Return a Pareto front of k objectives, by MOEA/D with differential evolution, Li and
    Zhang (2009).

    Each weight on a grid keeps the point whose largest weighted loss is least. Losses are scaled
    to run from 0 at the least to 1 at the greatest cost on the front.

    Args:
        costs: takes points (b, d) and gives their costs (b, k), inf if a point is not admitted.
        low, high: the corners of the box (d).
        seed: of the random numbers.
        starts: points to begin from (s, d).
        divisions: of the grid of weights, along each objective.
        rounds: of new points.
        tick: called after each round.

    Returns:
        The points (f, d) of the front and their costs (f, k).
    """
    rng = np.random.default_rng(seed)
    points = np.vstack([starts, low + (high - low) * rng.uniform(size=(SAMPLES, low.size))])
    values = costs(points)
    weights = np.maximum(_weight_grid(values.shape[1], divisions), 1e-3)
    near = _nearest_weights(weights)
    frame = _cost_range(values)
    chosen = scalar_costs(values, *frame, weights).argmin(axis=1)
    points = points[chosen]
    values = values[chosen]
    for turn in range(rounds):
        children = _breed_children(rng, points, near, low, high)
        offered = costs(children)
        if turn % 5 == 0:
            frame = _cost_range(np.vstack([values, offered]))
        present = scalar_costs(values, *frame, weights).diagonal()
        best, loss = _best_offers(scalar_costs(offered, *frame, weights), near)
        better = (loss < present)[:, None]
        points = np.where(better, children[best], points)
        values = np.where(better, offered[best], values)
        tick()
    undominated = np.flatnonzero(is_undominated(values) & np.isfinite(values).all(axis=1))
    _, firsts = np.unique(values[undominated].round(9), axis=0, return_index=True)
    distinct = undominated[np.sort(firsts)]
    return points[distinct], values[distinct]


def scalar_costs(values: Floats, least: Floats, greatest: Floats, weights: Floats) -> Floats:
    """Return the scalar cost (w, b) of b points for each of w weights: the largest weighted
    loss.

    A small part of the sum of the losses is added to it.

    Args:
        values: costs of the points (b, k).
        least, greatest: costs (k) at which a loss is 0 and 1.
        weights: (w, k).
    """
    loss = weights[:, None] * ((values - least) / np.maximum(greatest - least, 1e-9))
    return np.asarray(loss.max(axis=2) + TILT * loss.sum(axis=2))


def is_undominated(values: Floats) -> np.ndarray:
    """Return a mask of b points, given by their costs (b, k), that are not dominated (b)."""
    no_better = (values[:, None] >= values).all(axis=2)
    worse = no_better & (values[:, None] > values).any(axis=2)
    return ~np.any(worse, axis=1)


def _breed_children(
    rng: np.random.Generator, points: Floats, near: Integers, low: Floats, high: Floats
) -> Floats:
    """Return a new point for each weight (w, d), by differences of points (w, d) and rare
    jumps.
    """
    size, d = points.shape
    one = _choose_mates(rng, near)
    two = _choose_mates(rng, near)
    crossed = rng.uniform(size=(size, d)) < (0.9 if d < 5 else 0.5)
    children = np.where(crossed, points + 0.6 * (points[one] - points[two]), points)
    jumps = rng.uniform(size=(size, d)) < 1 / d
    jump = jumps * rng.normal(size=(size, d)) * rng.uniform(size=(size, 1)) ** 3
    return np.clip(children + 0.03 * (high - low) * jump, low, high)


def _choose_mates(rng: np.random.Generator, near: Integers) -> Integers:
    """Return, for each weight, the index of a point to mate with (w): a neighbour, or rarely
    any point.
    """
    size, neighbours = near.shape
    anywhere = rng.uniform(size=size) < 0.1
    any_point = rng.integers(0, size, size)
    neighbour = near[np.arange(size), rng.integers(0, neighbours, size)]
    return np.where(anywhere, any_point, neighbour)


def _nearest_weights(weights: Floats) -> Integers:
    """Return the indices of the nearest weights (w, at most NEIGHBOURS), the weight itself
    first.
    """
    distance = ((weights[:, None] - weights) ** 2).sum(axis=2)
    return np.argsort(distance, axis=1)[:, :NEIGHBOURS]


def _best_offers(losses: Floats, near: Integers) -> tuple[Integers, Floats]:
    """Return, for each weight, the index (w) and scalar cost (w) of the best new point of its
    neighbours.

    Args:
        losses: scalar cost (w, w) under each weight (first axis) of each new point (second).
        near: the neighbours of each weight (w, neighbours).
    """
    offers = np.full(losses.shape, np.inf)
    np.put_along_axis(offers, near, np.take_along_axis(losses, near, axis=1), axis=1)
    best = offers.argmin(axis=1)
    return best, offers[np.arange(len(offers)), best]


def _cost_range(values: Floats) -> tuple[Floats, Floats]:
    """Return the least and greatest costs (k) on the front of the points so far, from their
    costs (b, k).
    """
    admitted = values[np.isfinite(values).all(axis=1)]
    front = admitted[is_undominated(admitted)]
    return front.min(axis=0), front.max(axis=0)


def _weight_grid(k: int, divisions: int) -> Floats:
    """Return all k-tuples of multiples of 1 / divisions whose sum is 1."""
    tuples = itertools.product(range(divisions + 1), repeat=k)
    return np.array([parts for parts in tuples if sum(parts) == divisions]) / divisions
