"""Fair tuning: the same budget of candidates for every method, on the same scenarios."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from undeadzone.numerics.optimise import minimise_by_cmaes
from undeadzone.scenario.schema import Scenario
from undeadzone.util.answers import open_answers
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.leaderboard import CAP, compute_regrets
from undeadzone_arena.contest.methods import Method, method_registry, middle_knobs
from undeadzone_arena.contest.metric import Result
from undeadzone_arena.contest.prior_knowledge import Setting, build_settings
from undeadzone_arena.contest.trials import result_dependencies, run_trial, score_methods
from undeadzone_arena.contest.tuned_file import Tuned, TunedMethod
from undeadzone_studies.ensemble.local_workers import iterate_results

SEEDS: Final = (1000,)  # of noise and gusts, others than those of the results
SPREAD: Final = 0.25  # first steps of the search, as a share of a range


def tune_methods(
    names: Sequence[str],
    grounds: Mapping[str, Scenario],
    budget: int,
    seeds: Sequence[int] = SEEDS,
    search: int = 0,
    processes: int | None = None,
    progress: Callable[[int], None] | None = None,
    keep: Path | None = None,
    resume: bool = False,
) -> Tuned:
    """Tune the knobs of each method for a small mean regret.

    Args:
        names: of the methods.
        grounds: scenarios to tune on, by name.
        budget: candidates of each method.
        seeds: of the runs.
        search: seed of the evolution.
        processes: at once (None: one per processor).
        progress: called with the number of methods just done.
        keep: file that keeps the results of methods, to be deleted once they are saved (None:
            none).
        resume: continue a stopped run from the results in `keep`.

    Raises:
        InputError: or a subclass.
    """
    known = method_registry()
    frame = score_methods((), grounds, seeds, numbers={}, processes=1)
    adjustable = [name for name in dict.fromkeys(names) if known[name].knobs]

    def compute(missing: list[int]) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the tuned numbers of methods as they finish."""
        count = (os.cpu_count() or 1) if processes is None else processes
        rest = dict(grounds), frame, budget, tuple(seeds), search
        tasks = {k: (adjustable[k], *rest) for k in missing}
        for k, found in iterate_results(count, _tune_method, tasks):
            yield k, msgspec.to_builtins(found)
            if progress is not None:
                progress(1)

    def describe() -> dict[str, Any]:
        """Return all data that the tuned numbers depend on."""
        return result_dependencies(grounds, seeds, {}) | {"budget": budget, "search": search}

    with open_answers(keep, describe, "methods", resume) as answers:
        plain = answers.compute_missing(adjustable, compute)
    methods = msgspec.convert(dict(zip(adjustable, plain, strict=True)), dict[str, TunedMethod])
    return Tuned(
        budget=budget, seeds=list(seeds), search=search, scenarios=list(grounds), methods=methods
    )


def _tune_method(
    name: str,
    scenarios: Mapping[str, Scenario],
    frame: list[Result],
    budget: int,
    seeds: Sequence[int],
    search: int,
) -> TunedMethod:
    """Tune the knobs of one method, in its own process."""
    grounds = build_settings(scenarios)
    method = method_registry()[name]

    def cost(numbers: Mapping[str, float]) -> float:
        """Return the mean regret of knobs."""
        return mean_regret(method, grounds, frame, seeds, numbers)

    return best_candidate(method, cost, budget, search)


def best_candidate(
    method: Method, cost: Callable[[Mapping[str, float]], float], budget: int, search: int
) -> TunedMethod:
    """Return the candidate of least cost out of `budget`.

    They come from an evolution that begins in the middle of the ranges, on logarithmic scales, or
    from a grid for a single knob.

    Args:
        method: whose knobs.
        cost: cost(numbers) is made small.
        budget: how many candidates.
        search: seed of the evolution.
    """
    centre = middle_knobs(method)
    tried: list[tuple[float, dict[str, float]]] = [(cost(centre), centre)]

    def costs(shares: Floats) -> Floats:
        """Return the costs of candidates (b, d) given as shares, inf beyond the budget."""
        for row in shares[: budget - len(tried)]:
            numbers = _knobs_at_shares(method, row)
            tried.append((cost(numbers), numbers))
        fresh = [value for value, _ in tried[-len(shares) :]]
        return np.array(fresh + [np.inf] * (len(shares) - len(fresh)))

    d = len(method.knobs)
    if d == 1:
        costs(np.linspace(0.0, 1.0, budget - 1)[:, None])
    else:
        size = 4 + int(3 * np.log(d))
        rounds = -(-(budget - 1) // size)  # rounded up
        minimise_by_cmaes(
            costs, np.zeros(d), np.ones(d), search, size, rounds, np.full(d, 0.5), SPREAD
        )
    regret, numbers = min(tried, key=lambda each: each[0])
    return TunedMethod(regret=regret, before=tried[0][0], candidates=len(tried), knobs=numbers)


def _knobs_at_shares(method: Method, shares: Floats) -> dict[str, float]:
    """Return the numbers of a method's knobs at shares of their ranges, on logarithmic scales."""
    knobs = zip(method.knobs.items(), shares, strict=True)
    return {
        address: float(knob.low * (knob.high / knob.low) ** share)
        for (address, knob), share in knobs
    }


def mean_regret(
    method: Method,
    grounds: Mapping[str, Setting],
    frame: list[Result],
    seeds: Sequence[int],
    numbers: Mapping[str, float],
) -> float:
    """Return the mean regret of a method over scenarios and seeds [zones].

    It counts CAP if the method is not applicable with these numbers, lest it be tuned to refuse
    hard scenarios.

    Args:
        method: the method to tune.
        grounds: scenarios by name, and what may be known of them.
        frame: results of the lines that are always there.
        seeds: of the runs.
        numbers: of the method's knobs, by address.
    """
    own: list[Result] = []
    for title, ground in grounds.items():
        own += run_trial("own", method, title, ground, seeds, numbers)
    regret = compute_regrets([*frame, *own])["own"]
    return float(np.where(np.isnan(regret), CAP, regret).mean())
