"""Runs of methods on scenarios, one after the other or in processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.arena.leaderboard import FRAME
from undeadzone.arena.methods import NOTHING, Method, Numbers, catalogue, entered, require
from undeadzone.arena.methods import numbers as built_in
from undeadzone.arena.metric import Result, worth
from undeadzone.arena.prior_knowledge import Setting, situation
from undeadzone.arena.scenario_sets import scenarios as scenarios_of
from undeadzone.engine import interpret
from undeadzone.errors import UndeadzoneError
from undeadzone.observers import NumericObserver
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation import sample_by_sample as live
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.simulate import closed, named
from undeadzone.support import tree
from undeadzone.support.arrays import Floats


def trial(
    name: str,
    method: Method,
    title: str,
    ground: Setting,
    seeds: Sequence[int],
    numbers: Mapping[str, float] = NOTHING,
) -> list[Result]:
    """A method on a scenario, a run per seed; that the method refuses it is a result."""
    try:
        problem = resolve_scenario(entered(method, ground, numbers))
    except (UndeadzoneError, np.linalg.LinAlgError) as error:
        return [
            Result(method=name, scenario=title, seed=seed, worth=None, reason=str(error))
            for seed in seeds
        ]
    runs = zip(seeds, _runs(problem, seeds), strict=True)
    return [
        Result(method=name, scenario=title, seed=seed, worth=worth(problem, *run))
        for seed, run in runs
    ]


def signals(problem: Problem, seed: int) -> Outputs:
    """The signals of one run."""
    return next(iter(_runs(problem, [seed])))[0]


def _runs(problem: Problem, seeds: Sequence[int]) -> Iterator[tuple[Outputs, Floats, float]]:
    """(signals, true widths at the end (2 x p), seconds per step) of each run."""
    observer = problem.observer
    loop = None if isinstance(observer, NumericObserver) else closed(problem)
    for seed in seeds:
        exogenous = inputs.exogenous(problem, seed=seed)
        began = time.perf_counter()
        if isinstance(observer, NumericObserver):
            simulation = msgspec.structs.replace(problem.scenario.simulation, seed=seed)
            seeded = problem._replace(
                scenario=msgspec.structs.replace(problem.scenario, simulation=simulation)
            )
            out = live.run_sample_by_sample(seeded, observer, exogenous)
        else:
            assert loop is not None
            state = tree.pack(loop.state._replace(plant=problem.x0))
            out = named(loop, interpret.run(loop.step, state, exogenous, tree.pack(loop.params))[0])
        yield (
            out,
            inputs.widths(problem, exogenous)[-1],
            (time.perf_counter() - began) / len(exogenous),
        )


FEW: Final = 8  # trials for which a process is worth starting


class Job(NamedTuple):
    """A trial to be done: all that a process is sent. method: None for that of this name in the catalogue."""

    name: str
    method: Method | None
    scenario: str
    given: Scenario
    seeds: tuple[int, ...]
    numbers: Mapping[str, float]


def score(
    methods: Sequence[str] | Mapping[str, Method] | None = None,
    scenarios: Mapping[str, Scenario] | None = None,
    seeds: Sequence[int] = (0, 1, 2),
    *,
    numbers: Numbers | None = None,
    processes: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[Result]:
    """The results of methods (default: all) on scenarios (default: those held out), with the two lines that make a regret (FRAME).

    methods: names in the catalogue, or methods of one's own by name, which run in this process. numbers: of their knobs
    (default: those that come with the package). processes: default one per processor. progress: told of the runs just done. Raises InputError and its kinds.
    """
    own = methods if isinstance(methods, Mapping) else {}
    named = (
        list(catalogue()) if methods is None else [] if own else [require(name) for name in methods]
    )
    names = list(dict.fromkeys([*FRAME, *named, *own]))
    values = built_in() if numbers is None else numbers
    grounds = scenarios_of("held_out") if scenarios is None else scenarios
    jobs = [
        Job(name, own.get(name), title, given, tuple(seeds), dict(values.get(name, {})))
        for title, given in grounds.items()
        for name in names
    ]
    found: list[list[Result]] = [[] for _ in jobs]
    for k, results in _done(jobs, 1 if own else processes):
        found[k] = results
        if progress is not None:
            progress(len(results))
    return [result for results in found for result in results]


def _done(jobs: Sequence[Job], processes: int | None) -> Iterator[tuple[int, list[Result]]]:
    """Results by number of the job, as they come; processes are started anew, so that nothing is inherited."""
    count = min(len(jobs) // FEW, (os.cpu_count() or 1) if processes is None else processes)
    if count <= 1:
        yield from ((k, _try(job)) for k, job in enumerate(jobs))
        return
    with ProcessPoolExecutor(count, get_context("spawn")) as pool:
        waiting = {pool.submit(_try, job): k for k, job in enumerate(jobs)}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _try(job: Job) -> list[Result]:
    method = catalogue()[job.name] if job.method is None else job.method
    return trial(job.name, method, job.scenario, situation(job.given), job.seeds, job.numbers)
