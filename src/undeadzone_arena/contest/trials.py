"""Runs of methods on scenarios, one after the other or in processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from undeadzone.simulation.loop import Loop, Outputs
from undeadzone.simulation.simulate import close_problem, name_outputs
from undeadzone.util import toml, tree
from undeadzone.util.answers import Answers
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.entry import enter_method
from undeadzone_arena.contest.entry import numbers as built_in
from undeadzone_arena.contest.leaderboard import FRAME
from undeadzone_arena.contest.methods import NOTHING, Method, Numbers, catalogue, fitting, require
from undeadzone_arena.contest.metric import Result, worth
from undeadzone_arena.contest.prior_knowledge import Setting, situation
from undeadzone_arena.contest.processes import as_done
from undeadzone_arena.contest.scenario_sets import scenarios as scenarios_of

FEW: Final = 8  # trials for which a process is worth starting


class _TrialRun(NamedTuple):
    """A run: its signals, true widths at the end (2 x p), and seconds per step."""

    out: Outputs
    truth: Floats
    cost: float


def trial(
    name: str,
    method: Method,
    title: str,
    ground: Setting,
    seeds: Sequence[int],
    numbers: Mapping[str, float] = NOTHING,
) -> list[Result]:
    """Return a method on a scenario, a run per seed; that the method refuses it is a result.

    Args:
        name: of the method.
        method: what is tried.
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
    for seed, run in zip(seeds, _runs(problem, seeds), strict=True):
        value = worth(problem, run.out, run.truth, run.cost)
        results.append(Result(method=name, scenario=title, seed=seed, worth=value))
    return results


def signals(problem: Problem, seed: int) -> Outputs:
    """Return the signals of one run."""
    return next(iter(_runs(problem, [seed]))).out


def _runs(problem: Problem, seeds: Sequence[int]) -> Iterator[_TrialRun]:
    """Yield the runs of a problem."""
    observer = problem.observer
    loop = None if observer.python is not None else close_problem(problem)
    for seed in seeds:
        exogenous = inputs.exogenous(problem, seed=seed)
        began = time.perf_counter()
        if observer.python is not None:
            out = live.run_sample_by_sample(_seeded(problem, seed), exogenous)
        else:
            assert loop is not None
            out = _interpreted(loop, problem, exogenous)
        truth = inputs.widths(problem, exogenous)[-1]
        yield _TrialRun(out, truth, (time.perf_counter() - began) / len(exogenous))


def _seeded(problem: Problem, seed: int) -> Problem:
    """Return the problem with another seed."""
    simulation = msgspec.structs.replace(problem.scenario.simulation, seed=seed)
    scenario = msgspec.structs.replace(problem.scenario, simulation=simulation)
    return problem._replace(scenario=scenario)


def _interpreted(loop: Loop, problem: Problem, exogenous: Floats) -> Outputs:
    """Return the outputs of a loop on CasADi's virtual machine."""
    state = tree.pack(loop.state._replace(plant=problem.x0))
    outputs, _ = interpret.run_interpreted(loop.step, state, exogenous, tree.pack(loop.params))
    return name_outputs(loop, outputs)


class Job(NamedTuple):
    """A trial to be done: all that a process is sent.

    Attributes:
        name: of the method.
        method: the method; None: that of this name in the catalogue.
        title: of the scenario.
        scenario: the scenario.
        seeds: of the runs.
        numbers: of the method's knobs, by address.
    """

    name: str
    method: Method | None
    title: str
    scenario: Scenario
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
    kept: Answers | None = None,
) -> list[Result]:
    """Yield the results of methods on scenarios, with the lines that are always there (FRAME).

    Args:
        methods: names in the catalogue, or methods of one's own by name, which run in this
            process; None: all of the catalogue that fit.
        scenarios: by name; None: those held out.
        seeds: of the runs of each method on each scenario.
        numbers: of the knobs, by method; None: those that come with the package.
        processes: at once; None: one per processor.
        progress: called with the number of runs just done.
        kept: results of an earlier run on disk, of methods of the catalogue; None: none.

    Raises:
        InputError: or a subclass.
    """
    own = methods if isinstance(methods, Mapping) else {}
    grounds = scenarios_of("held_out") if scenarios is None else scenarios
    names = list(dict.fromkeys([*FRAME, *_names(methods, grounds)]))
    values = built_in() if numbers is None else numbers
    jobs = []
    for title, scenario in grounds.items():
        for name in names:
            knobs = dict(values.get(name, {}))
            jobs.append(Job(name, own.get(name), title, scenario, tuple(seeds), knobs))

    def compute(missing: list[int]) -> Iterator[tuple[int, list[Any]]]:
        """Yield results as they come, in the form in which they are kept."""
        for k, results in _done([jobs[k] for k in missing], 1 if own else processes):
            yield missing[k], msgspec.to_builtins(results)
            if progress is not None:
                progress(len(results))

    if kept is None:
        by_number = dict(compute(list(range(len(jobs)))))
        plain = [by_number[k] for k in range(len(jobs))]
    else:
        plain = kept.of([[job.title, job.name] for job in jobs], compute)
    every: list[Result] = []
    for results in plain:
        every += msgspec.convert(results, list[Result])
    return every


def problem_of(
    scenarios: Mapping[str, Scenario], seeds: Sequence[int], numbers: Numbers
) -> dict[str, Any]:
    """Return everything that the results of methods of the catalogue depend on."""
    return {
        "scenarios": {title: toml.dumps(scenario) for title, scenario in scenarios.items()},
        "files": {title: digests(scenario) for title, scenario in scenarios.items()},
        "seeds": list(seeds),
        "numbers": {name: dict(knobs) for name, knobs in numbers.items()},
    }


def _names(
    methods: Sequence[str] | Mapping[str, Method] | None, grounds: Mapping[str, Scenario]
) -> list[str]:
    """Return the names of methods. Raises InputError for one that is not in the catalogue."""
    if methods is None:
        return fitting(grounds.values())
    if isinstance(methods, Mapping):
        return list(methods)
    return [require(name) for name in methods]


def processes_for(jobs: int, processes: int | None) -> int:
    """How many processes work at once on so many jobs; processes: at most, None: one per CPU."""
    allowed = (os.cpu_count() or 1) if processes is None else processes
    return max(1, min(jobs // FEW, allowed))


def _done(jobs: Sequence[Job], processes: int | None) -> Iterator[tuple[int, list[Result]]]:
    """Yield results by number of the job, as they come.

    Processes are started anew, so that nothing is inherited.
    """
    count = processes_for(len(jobs), processes)
    if count == 1:
        yield from ((k, _try(job)) for k, job in enumerate(jobs))
        return
    yield from as_done(count, _try, {k: (job,) for k, job in enumerate(jobs)})


def _try(job: Job) -> list[Result]:
    """Return the results of a job."""
    method = catalogue()[job.name] if job.method is None else job.method
    return trial(job.name, method, job.title, situation(job.scenario), job.seeds, job.numbers)
