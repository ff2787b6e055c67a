"""Fair tuning: the same budget of candidates for every method, on the same runs of the tuning scenarios."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Final

import numpy as np

from undeadzone.arena.leaderboard import CAP, FRAME, regrets
from undeadzone.arena.methods import Method, catalogue, middle
from undeadzone.arena.metric import Result
from undeadzone.arena.prior_knowledge import Setting, situation
from undeadzone.arena.trials import trial
from undeadzone.arena.tuned_file import Found, Tuned
from undeadzone.numerics.optimise import evolve
from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import Floats

BUDGET: Final = 60  # candidates of a method
SEEDS: Final = (1000,)  # of noise and gusts, others than those of the results
SPREAD: Final = 0.25  # first steps of the search, as a share of a range


def tune(
    names: Sequence[str],
    grounds: Mapping[str, Scenario],
    budget: int = BUDGET,
    seeds: Sequence[int] = SEEDS,
    search: int = 0,
    processes: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Tuned:
    """The numbers of each method's knobs that make its mean regret small; progress is told of methods done. Raises InputError and its kinds."""
    given = {title: situation(scenario) for title, scenario in grounds.items()}
    known = catalogue()
    frame = [
        result
        for name in FRAME
        for title, ground in given.items()
        for result in trial(name, known[name], title, ground, seeds)
    ]
    found: dict[str, Found] = {}
    with ProcessPoolExecutor(
        os.cpu_count() if processes is None else processes, get_context("spawn")
    ) as pool:
        waiting = {
            pool.submit(_search, name, dict(grounds), frame, budget, tuple(seeds), search): name
            for name in names
            if known[name].knobs
        }
        for future in as_completed(waiting):
            found[waiting[future]] = future.result()
            if progress is not None:
                progress(1)
    return Tuned(
        budget=budget,
        seeds=list(seeds),
        search=search,
        scenarios=list(grounds),
        methods={name: found[name] for name in names if name in found},
    )


def _search(
    name: str,
    scenarios: Mapping[str, Scenario],
    frame: list[Result],
    budget: int,
    seeds: Sequence[int],
    search: int,
) -> Found:
    grounds = {title: situation(scenario) for title, scenario in scenarios.items()}
    method = catalogue()[name]
    return best(
        method, lambda numbers: mean_regret(method, grounds, frame, seeds, numbers), budget, search
    )


def best(
    method: Method, cost: Callable[[Mapping[str, float]], float], budget: int, search: int
) -> Found:
    """The cheapest of `budget` candidates: evolution from the middle of the ranges, on logarithmic scales; a grid for a single knob."""
    tried: list[tuple[float, dict[str, float]]] = []

    def costs(shares: Floats) -> Floats:
        for row in shares[: budget - len(tried)]:
            numbers = {
                address: float(knob.low * (knob.high / knob.low) ** u)
                for (address, knob), u in zip(method.knobs.items(), row, strict=True)
            }
            tried.append((cost(numbers), numbers))
        fresh = [each for each, _ in tried[-len(shares) :]]
        return np.array(fresh + [np.inf] * (len(shares) - len(fresh)))

    tried.append((cost(middle(method)), middle(method)))
    d = len(method.knobs)
    if d == 1:
        costs(np.linspace(0.0, 1.0, budget - 1)[:, None])
    else:
        size = 4 + int(3 * np.log(d))
        evolve(
            costs,
            np.zeros(d),
            np.ones(d),
            search,
            size,
            -(-(budget - 1) // size),
            np.full(d, 0.5),
            SPREAD,
        )
    regret, numbers = min(tried, key=lambda each: each[0])
    return Found(regret=regret, before=tried[0][0], candidates=len(tried), knobs=numbers)


def mean_regret(
    method: Method,
    grounds: Mapping[str, Setting],
    frame: list[Result],
    seeds: Sequence[int],
    numbers: Mapping[str, float],
) -> float:
    """Over scenarios and seeds; CAP where the method is not applicable with these numbers, lest it be tuned to refuse what is hard."""
    own = [
        result
        for title, ground in grounds.items()
        for result in trial("own", method, title, ground, seeds, numbers)
    ]
    found = regrets([*frame, *own])["own"]
    return float(np.where(np.isnan(found), CAP, found).mean())
