"""Candidates as lanes: options that differ in numbers alone share one kernel and the same runs."""

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
    """Runs on which candidates for the options of one scenario are tried.

    Attributes:
        batch: the runs of the first candidate, ready to be computed
        graph: what candidates must have to share its kernel
        runs: their numbers
        values: of what varies (runs x columns)
    """

    batch: Batch
    graph: str
    runs: Integers
    values: Floats

    @property
    def problem(self) -> Problem:
        """The problem of the first candidate."""
        return self.batch.problem

    @property
    def varied(self) -> dict[str, Floats]:
        """What [ensemble] varies: its values in the runs, by name."""
        return dict(zip(self.batch.binding.names, self.values.T, strict=True))

    def redrawn(self, runs: int, seed: int) -> TestRuns:
        """The same on other runs: the first `runs` of a seed; one if nothing differs among them."""
        binding, own = self.batch.binding, self.batch.own
        differ = binding.columns or own.entries
        count = runs if differ else 1
        batch = self.batch._replace(
            binding=binding._replace(seed=seed), own=own._replace(seed=seed)
        )
        values = batch.binding.draw(0, count, runs)
        return self._replace(batch=batch, runs=np.arange(count), values=values)

    def rows(self, candidates: Sequence[Problem], threads: int | None = None) -> Floats:
        """The metrics (candidates x runs x columns) of candidates.

        Those that the kernel does not serve get one of their own. Raises InputError.
        """
        kinds = [_kind(self, candidate) for candidate in candidates]
        columns = len(self.batch.layout.columns) - self.values.shape[1]
        rows = np.empty((len(candidates), self.runs.size, columns))
        for kind in dict.fromkeys(kinds):
            chosen = [k for k, each in enumerate(kinds) if each == kind]
            group = [candidates[k] for k in chosen]
            runs = self
            if kind is not None:
                seed = self.batch.binding.seed
                runs = prepare_test_runs(group[0].scenario, group, self.runs.size, seed)
            rows[chosen] = _rows(runs, group, threads).reshape(len(chosen), *rows.shape[1:])
        return rows


def prepare_test_runs(
    scenario: Scenario, probes: Sequence[Problem], runs: int, seed: int
) -> TestRuns:
    """Test runs for a scenario whose candidates move the numbers that the probes move.

    Args:
        scenario: the first candidate
        probes: other candidates
        runs: how many
        seed: of what the runs draw

    Raises:
        InputError or a subclass
    """
    scenario = msgspec.structs.replace(scenario, ensemble=_table(scenario, runs, seed))
    problem = resolve_scenario(scenario)
    form, loop = graph(problem), closed(problem)
    nominal = tree.pack(loop.params)
    moved: set[int] = set()
    for probe in probes:
        if graph(probe) == form:
            _, params = _numbers(loop, probe)
            moved.update(np.flatnonzero(params != nominal).tolist())
    for column in bind(problem, loop).columns:
        if moved & {slot for slot, _ in column.slots}:
            raise InputError(
                f"tune: [ensemble] varies {column.name}, which what is tuned decides; "
                "keep one of them"
            )
    batch = prepare(scenario, moved)
    return TestRuns(batch, form, np.empty(0, int), np.empty((0, 0))).redrawn(runs, seed)


def _table(scenario: Scenario, runs: int, seed: int) -> Vary:
    """The table [ensemble] for test runs; those of Saltelli's design are not independent."""
    vary = scenario.ensemble or Vary()
    sampling = "sobol" if vary.sampling == "saltelli" else vary.sampling
    return msgspec.structs.replace(vary, runs=runs, seed=seed, sampling=sampling)


def _kind(runs: TestRuns, candidate: Problem) -> str | None:
    """None for a candidate that the kernel serves, else its graph."""
    form = graph(candidate)
    if form != runs.graph:
        return form
    binding = runs.batch.binding
    shared = np.delete(np.arange(binding.params.size), binding.indices)
    _, params = _numbers(runs.batch.loop, candidate)
    return None if np.array_equal(params[shared], binding.params[shared]) else form


def _rows(runs: TestRuns, candidates: list[Problem], threads: int | None) -> Floats:
    """The metrics of candidates that the kernel serves: candidate by candidate, run by run."""
    batch, parts = runs.batch, []
    for candidate in candidates:
        state, params = _numbers(batch.loop, candidate)
        parts.append(batch.binding._replace(state=state, params=params).lanes(runs.values))
    lanes = parts[0]._replace(
        states=np.concatenate([part.states for part in parts]),
        params=np.concatenate([part.params for part in parts]),
    )
    return batch.measure(np.tile(runs.runs, len(candidates)), lanes, threads)


def graph(problem: Problem) -> str:
    """Observer and controller without their numbers, but with those of a plan, as text.

    It is equal for problems that one kernel serves. Raises InputError if there is no graph.
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
    u, y = ca.SX.sym("u", model.m), ca.SX.sym("y", model.p)
    side, x = ca.SX.sym("side", model.p), ca.SX.sym("x", model.n)
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
    function = ca.Function("graph", inputs, [tree.stack(result) for result in results])
    plan = () if controller.plan is None else tree.pack(controller.plan.params).tolist()
    return str(function.serialize()) + str((tree.names((observer.params, like)), plan))


def _numbers(loop: Loop, candidate: Problem) -> tuple[Floats, Floats]:
    """(initial state, params), packed, of a loop with a candidate's observer and controller.

    The candidate has the graph of the loop.
    """
    observer, controller = graph_of(candidate.observer), candidate.controller
    params: Any = loop.params._replace(observer=observer.params, controller=controller.params)
    state = loop.state._replace(
        plant=candidate.x0,
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
    )
    return tree.pack(state), tree.pack(params)
