"""Runs of methods on scenarios, in sequence or in processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import itemgetter
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.compile import interpret
from undeadzone.errors import UndeadzoneError
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.reader import digests
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation import sample_by_sample as live
from undeadzone.simulation.loop import Outputs
from undeadzone.simulation.simulate import outputs_of, prepare
from undeadzone.util import toml
from undeadzone.util.answers import MemoryAnswers
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.entry import enter_method
from undeadzone_arena.contest.entry import read_knob_numbers as built_in
from undeadzone_arena.contest.leaderboard import FRAME
from undeadzone_arena.contest.methods import (
    NOTHING,
    Method,
    Numbers,
    method_registry,
    methods_for_scenarios,
    require_method,
)
from undeadzone_arena.contest.metric import Result, measure_run
from undeadzone_arena.contest.prior_knowledge import Setting, build_setting
from undeadzone_arena.contest.scenario_sets import arena_scenarios as scenarios_of
from undeadzone_studies.ensemble.local_workers import iterate_results

FEW: Final = 8  # trials for which a process is worth starting


class _TrialRun(NamedTuple):
    """Run: its signals, true widths at the end (2 x p), and seconds per step."""

    out: Outputs
    truth: Floats
    cost: float


def run_trial(
    name: str,
    method: Method,
    title: str,
    ground: Setting,
    seeds: Sequence[int],
    numbers: Mapping[str, float] = NOTHING,
) -> list[Result]:
    """Run a method on a scenario with each seed. A refusal by the method is a result, too.

    Args:
        name: of the method.
        method: the method to run.
        title: of the scenario.
        ground: the scenario, and what may be known of it.
        seeds: of the runs.
        numbers: of the method's knobs, by address.
    """
    try:
        problem = resolve_scenario(enter_method(method, ground, numbers))
    except (UndeadzoneError, np.linalg.LinAlgError) as error:
        reason = str(error)
        return [
            Result(method=name, scenario=title, seed=seed, worth=None, reason=reason)
            for seed in seeds
        ]
    results = []
    for seed, run in zip(seeds, _iterate_runs(problem, seeds), strict=True):
        value = measure_run(problem, run.out, run.truth, run.cost)
        results.append(Result(method=name, scenario=title, seed=seed, worth=value))
    return results


def trial_signals(problem: Problem, seed: int) -> Outputs:
    """Return the signals of one run."""
    return next(iter(_iterate_runs(problem, [seed]))).out


def _iterate_runs(problem: Problem, seeds: Sequence[int]) -> Iterator[_TrialRun]:
    """Yield the runs of a problem."""
    observer = problem.observer
    start = None if observer.python is not None else prepare(problem)
    for seed in seeds:
        exogenous = inputs.exogenous(problem, seed=seed)
        began = time.perf_counter()
        if start is None:
            out = live.run_sample_by_sample(_with_seed(problem, seed), exogenous)
        else:
            run = start._replace(exogenous=exogenous)
            out = outputs_of(run, run=partial(interpret.run_interpreted, start.loop.step))
        truth = inputs.widths(problem, exogenous)[-1]
        yield _TrialRun(out, truth, (time.perf_counter() - began) / len(exogenous))


def _with_seed(problem: Problem, seed: int) -> Problem:
    """Return the problem with another seed."""
    simulation = msgspec.structs.replace(problem.scenario.simulation, seed=seed)
    scenario = msgspec.structs.replace(problem.scenario, simulation=simulation)
    return problem._replace(scenario=scenario)


def score_methods(
    methods: Sequence[str] | Mapping[str, Method] | None = None,
    scenarios: Mapping[str, Scenario] | None = None,
    seeds: Sequence[int] = (0, 1, 2),
    *,
    numbers: Numbers | None = None,
    processes: int | None = None,
    progress: Callable[[int], None] | None = None,
    saved_results: MemoryAnswers | None = None,
) -> list[Result]:
    """Run methods on scenarios, with the reference lines (FRAME), and return the results.

    Args:
        methods: names in the catalogue, or methods of one's own by name, which run in this process
            (None: all of the catalogue that fit).
        scenarios: by name (None: those held out).
        seeds: of the runs of each method on each scenario.
        numbers: of the knobs, by method (None: those that come with the package).
        processes: at once (None: one per processor).
        progress: called with the number of runs just done.
        saved_results: results of an earlier run, of methods of the catalogue (None: none).

    Raises:
        InputError: or a subclass.
    """
    own = methods if isinstance(methods, Mapping) else NOTHING
    known = {**method_registry(), **own}
    grounds = scenarios_of("held_out") if scenarios is None else scenarios
    names = list(dict.fromkeys([*FRAME, *resolve_names(methods, grounds)]))
    values = built_in() if numbers is None else numbers
    jobs: list[tuple[Any, ...]] = []
    for title, scenario in grounds.items():
        for name in names:
            rest = scenario, tuple(seeds), dict(values.get(name, NOTHING))
            jobs.append((title, name, known[name], *rest))

    def compute(missing: list[int]) -> Iterator[tuple[int, list[Any]]]:
        """Yield results as they finish, in the form in which they are stored."""
        for k, results in _iterate_jobs([jobs[k] for k in missing], 1 if own else processes):
            yield missing[k], msgspec.to_builtins(results)
            if progress is not None:
                progress(len(results))

    questions = list(map(itemgetter(0, 1), jobs))
    plain = (saved_results or MemoryAnswers()).compute_missing(questions, compute)
    every: list[Result] = []
    for results in plain:
        every += msgspec.convert(results, list[Result])
    return every


def result_dependencies(
    scenarios: Mapping[str, Scenario], seeds: Sequence[int], numbers: Numbers
) -> dict[str, Any]:
    """Return all inputs on which the results of registered methods depend."""
    return {
        "scenarios": {title: toml.to_toml(scenario) for title, scenario in scenarios.items()},
        "files": {title: digests(scenario) for title, scenario in scenarios.items()},
        "seeds": list(seeds),
        "numbers": {name: dict(knobs) for name, knobs in numbers.items()},
    }


def resolve_names(
    methods: Sequence[str] | Mapping[str, Method] | None, grounds: Mapping[str, Scenario]
) -> list[str]:
    """Return the names of methods. Raises InputError for an unregistered name."""
    if methods is None:
        return methods_for_scenarios(grounds.values())
    if isinstance(methods, Mapping):
        return list(methods)
    return list(map(require_method, methods))


def process_count(jobs: int, processes: int | None) -> int:
    """Return the number of processes for a number of jobs.

    The limit is `processes`, or one per CPU.
    """
    allowed = (os.cpu_count() or 1) if processes is None else processes
    return max(1, min(jobs // FEW, allowed))


def _iterate_jobs(
    jobs: Sequence[tuple[Any, ...]], processes: int | None
) -> Iterator[tuple[int, list[Result]]]:
    """Yield results by number of the job, in order of completion.

    Processes are started anew, so that nothing is inherited.
    """
    count = process_count(len(jobs), processes)
    if count == 1:
        yield from ((k, _run_job(*job)) for k, job in enumerate(jobs))
        return
    yield from iterate_results(count, _run_job, dict(enumerate(jobs)))


def _run_job(title: str, name: str, method: Method, scenario: Scenario, *rest: Any) -> list[Result]:
    """Run a method on a scenario and return its results (rest: seeds and knobs)."""
    return run_trial(name, method, title, build_setting(scenario), *rest)
