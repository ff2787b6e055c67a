"""Candidates as lanes: options that differ in their numbers alone share one kernel, the same runs for each of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.ensemble.batch import Batch, prepare
from undeadzone.ensemble.binding import bind
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Reading, graph_of
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.simulate import closed
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers


class TestRuns(NamedTuple):
    """Runs on which candidates for the options of one scenario are tried; graph: what they must share."""

    fleet: Batch
    graph: str
    runs: Integers
    values: Floats

    @property
    def problem(self) -> Problem:
        """The problem of the first candidate."""
        return self.fleet.problem

    @property
    def varied(self) -> dict[str, Floats]:
        """What [ensemble] varies: its values in the runs, by name."""
        return dict(zip(self.fleet.binding.names, self.values.T, strict=True))

    def redrawn(self, runs: int, seed: int) -> TestRuns:
        """The bench with other runs: the first `runs` of a seed; one if nothing differs between them."""
        binding, own = self.fleet.binding, self.fleet.own
        count = 1 if not binding.columns and not own.entries else runs
        fleet = self.fleet._replace(
            binding=binding._replace(seed=seed), own=own._replace(seed=seed)
        )
        return self._replace(
            fleet=fleet, runs=np.arange(count), values=fleet.binding.draw(0, count, runs)
        )

    def rows(self, candidates: Sequence[Problem], threads: int | None = None) -> Floats:
        """The metrics (candidates x runs x columns) of candidates; those that the kernel does not serve get one of their own. Raises InputError."""
        kinds = [_kind(self, candidate) for candidate in candidates]
        found = np.empty(
            (len(candidates), self.runs.size, len(self.fleet.layout.columns) - self.values.shape[1])
        )
        for kind in dict.fromkeys(kinds):
            chosen = [k for k, each in enumerate(kinds) if each == kind]
            group = [candidates[k] for k in chosen]
            here = (
                self
                if kind is None
                else bench(group[0].scenario, group, self.runs.size, self.fleet.binding.seed)
            )
            found[chosen] = _rows(here, group, threads).reshape(len(chosen), *found.shape[1:])
        return found


def bench(scenario: Scenario, probes: Sequence[Problem], runs: int, seed: int) -> TestRuns:
    """A bench for a scenario whose candidates move the numbers that the probes move. Raises InputError and its kinds."""
    vary = scenario.ensemble or Vary()
    sampling = (
        "sobol" if vary.sampling == "saltelli" else vary.sampling
    )  # whose runs are not independent
    scenario = msgspec.structs.replace(
        scenario, ensemble=msgspec.structs.replace(vary, runs=runs, seed=seed, sampling=sampling)
    )
    problem = resolve_scenario(scenario)
    form, loop = graph(problem), closed(problem)
    nominal = tree.pack(loop.params)
    moved = {
        int(i)
        for probe in probes
        if graph(probe) == form
        for i in np.flatnonzero(_numbers(loop, probe)[1] != nominal)
    }
    for column in bind(problem, loop).columns:
        if moved & {slot for slot, _ in column.slots}:
            raise InputError(
                f"tune: [ensemble] varies {column.name}, which what is tuned decides; keep one of them"
            )
    return TestRuns(prepare(scenario, moved), form, np.empty(0, int), np.empty((0, 0))).redrawn(
        runs, seed
    )


def _kind(given: TestRuns, candidate: Problem) -> str | None:
    """None for a candidate that the kernel serves, else its graph."""
    form = graph(candidate)
    if form != given.graph:
        return form
    outside = np.delete(np.arange(given.fleet.binding.params.size), given.fleet.binding.indices)
    params = _numbers(given.fleet.loop, candidate)[1]
    return None if np.array_equal(params[outside], given.fleet.binding.params[outside]) else form


def _rows(given: TestRuns, candidates: list[Problem], threads: int | None) -> Floats:
    """Candidate by candidate, run by run."""
    fleet, parts = given.fleet, []
    for candidate in candidates:
        state, params = _numbers(fleet.loop, candidate)
        parts.append(fleet.binding._replace(state=state, params=params).lanes(given.values))
    lanes = parts[0]._replace(
        states=np.concatenate([part.states for part in parts]),
        params=np.concatenate([part.params for part in parts]),
    )
    return fleet.measure(np.tile(given.runs, len(candidates)), lanes, threads)


def graph(problem: Problem) -> str:
    """Observer and controller without their numbers, but with those of a plan: equal for problems that one kernel serves.

    Raises InputError if there is no graph.
    """
    observer, controller, model = graph_of(problem.observer), problem.controller, problem.model
    p_column, p = tree.symbols((observer.params, controller.params), "p")
    like = observer.init(observer.params), controller.init(controller.params)
    s_column, s = tree.symbols(like, "s")
    instant = Target(
        np.zeros(len(problem.tracked)),
        np.zeros(model.n),
        np.zeros(model.m),
        np.zeros(controller.planned),
    )
    t_column, target = tree.symbols(instant, "t")
    u, y, side, x = (
        ca.SX.sym(name, size)
        for name, size in (("u", model.m), ("y", model.p), ("side", model.p), ("x", model.n))
    )
    moved, estimate = observer.step(p[0], s[0], u, Reading(y, side, x))
    results = (
        moved,
        estimate,
        observer.project(p[0], s[0]),
        observer.init(p[0]),
        controller.step(p[1], s[1], estimate, target),
        controller.init(p[1]),
    )
    inputs = [p_column, s_column, t_column, u, y, side, x]
    plan = () if controller.plan is None else tree.pack(controller.plan.params).tolist()
    return str(
        ca.Function("graph", inputs, [tree.stack(result) for result in results]).serialize()
    ) + str((tree.names((observer.params, like)), plan))


def _numbers(loop: Loop, candidate: Problem) -> tuple[Floats, Floats]:
    """(initial state, params), packed, of a loop with the observer and controller of a candidate that has its graph."""
    observer, controller = graph_of(candidate.observer), candidate.controller
    params: Any = loop.params._replace(observer=observer.params, controller=controller.params)
    state = loop.state._replace(
        plant=candidate.x0,
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
    )
    return tree.pack(state), tree.pack(params)
