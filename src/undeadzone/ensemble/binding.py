"""From what varies to each run's own numbers: a scenario's [ensemble] bound to its loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.ensemble.addresses import quantities
from undeadzone.ensemble.uncertain import UncertainNumber, columns
from undeadzone.errors import InputError
from undeadzone.interfaces import NumericObserver, graph_of
from undeadzone.linear import batched_hold as hold
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.simulate import closed
from undeadzone.statistics import sampling
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, scalar


class Lanes(NamedTuple):
    """Of each run: its packed initial state (count x S) and its own values (count x P) of the packed params `indices`."""

    states: Floats
    indices: tuple[int, ...]
    params: Floats


class Sampled(NamedTuple):
    """A linear plant that is sampled anew for each run: [A, B] (n x (n + m)) in continuous time, packed from `start` on."""

    start: int
    AB: Floats
    Ts: float

    @property
    def slots(self) -> range:
        """Where [Ad, Bd] stands, column by column."""
        return range(self.start, self.start + self.AB.size)

    def values(self, own: dict[int, Floats], count: int) -> dict[int, Floats]:
        """[Ad, Bd] of `count` runs by slot, given the entries of [A, B] that are their own."""
        rows, columns = self.AB.shape
        AB = np.empty((rows, columns, count))
        for i, slot in enumerate(self.slots):
            AB[i % rows, i // rows] = own.get(slot, self.AB[i % rows, i // rows])
        held = hold.zoh(AB, self.Ts)
        return {slot: held[i % rows, i // rows] for i, slot in enumerate(self.slots)}


class Binding(NamedTuple):
    """What varies, bound to a loop: a run's numbers are a function of the scenario, the seed and the run's number.

    state, params: nominal, packed; indices: of the params that differ between runs; copies: (entry of the state, entry of
    the params that it starts from), where that one differs.
    """

    columns: tuple[UncertainNumber, ...]
    sampling: str
    seed: int
    state: Floats
    params: Floats
    indices: tuple[int, ...]
    sampled: tuple[Sampled, ...]
    copies: tuple[tuple[int, int], ...]

    @property
    def names(self) -> list[str]:
        """The columns that are drawn, such as `sensor.right[0]`; one that holds factors on nominal values ends in (relative)."""
        return [column.name for column in self.columns]

    def draw(self, first: int, count: int, runs: int) -> Floats:
        """The values (count x columns) of the runs first .. first + count of `runs`. Raises InputError."""
        u = sampling.points(self.sampling, self.seed, first, count, len(self.columns), runs)
        return (
            np.stack(
                [column.spread.quantile(u[:, i].copy()) for i, column in enumerate(self.columns)],
                axis=1,
            )
            if self.columns
            else u
        )

    def lanes(self, values: Floats) -> Lanes:
        """The states and params of runs with these values (count x columns)."""
        count, size = len(values), self.params.size
        own = {
            slot: factor * values[:, i]
            for i, column in enumerate(self.columns)
            for slot, factor in column.slots
        }
        for system in self.sampled:
            own |= system.values(own, count)
        states = np.repeat(self.state[None], count, axis=0)
        for entry, source in self.copies:
            states[:, entry] = own[source]
        for slot in own:
            if slot >= size:
                states[:, slot - size] = own[slot]
        numbers = [own[i] if i in own else np.full(count, self.params[i]) for i in self.indices]
        return Lanes(
            states, self.indices, np.stack(numbers, axis=1) if numbers else np.empty((count, 0))
        )

    def packed(self, values: Floats) -> tuple[Floats, Floats]:
        """(initial state, params), packed, of one run with these values (columns): the numbers of its lane, for any engine."""
        lane, params = self.lanes(np.asarray(values, float)[None]), self.params.copy()
        params[list(self.indices)] = lane.params[0]
        return lane.states[0], params


def bind(problem: Problem, loop: Loop) -> Binding:
    """The scenario's [ensemble] bound to the loop of its problem (`simulation.prepare`). Raises InputError by key."""
    vary = problem.scenario.ensemble
    if vary is None:
        raise InputError(
            'ensemble: missing; add a table [ensemble] with what varies, such as "sensor.right" = { uniform = [0.3, 2.0] }'
        )
    seed = _checked(vary, problem)
    drawn = columns(vary.entries, quantities(problem, loop), problem)
    params, state = tree.pack(loop.params), tree.pack(loop.state._replace(plant=problem.x0))
    varied = {slot for column in drawn for slot, _ in column.slots if slot < params.size}
    sampled = tuple(system for system in _sampled(problem, loop) if varied & set(system.slots))
    varied = varied.union(*(system.slots for system in sampled))
    copies = tuple(
        (entry, source) for entry, source in initial_copies(problem, loop) if source in varied
    )
    return Binding(
        drawn, vary.sampling, seed, state, params, tuple(sorted(varied)), sampled, copies
    )


def require_bound(scenario: Scenario) -> None:
    """Raise InputError for an [ensemble] that names what this scenario does not have."""
    if scenario.ensemble is not None and not isinstance(
        (problem := resolve_scenario(scenario)).observer, NumericObserver
    ):
        bind(problem, closed(problem))


def _checked(vary: Vary, problem: Problem) -> int:
    """The seed. Raises InputError."""
    seed = problem.scenario.simulation.seed if vary.seed is None else vary.seed
    if not 0 <= seed < 2**63:
        raise InputError(f"ensemble.seed: expected a whole number, 0 or more, found {seed}")
    if vary.runs < 1:
        raise InputError(f"ensemble.runs: expected 1 or more, found {vary.runs}")
    scalar("ensemble.tolerance", vary.tolerance, above=0.0)
    return seed


def _sampled(problem: Problem, loop: Loop) -> list[Sampled]:
    """The linear plants that the loop holds in sampled form."""
    names, found = tree.names(loop.params), []
    for first, system in (
        ("plant.A[0,0]", problem.plant),
        ("observer.model.A[0,0]", problem.model),
    ):
        if first in names and system.flow is not None and system.Ts is not None:
            found.append(
                Sampled(names.index(first), np.hstack([system.flow.A, system.flow.B]), system.Ts)
            )
    return found


def initial_copies(problem: Problem, loop: Loop) -> list[tuple[int, int]]:
    """(entry of the packed state, entry of the packed params) for each number of the state that starts as one of the params."""
    column, p = tree.symbols(loop.params, "p")
    state = tree.stack(
        loop.state._replace(
            observer=graph_of(problem.observer).init(p.observer),
            controller=problem.controller.init(p.controller),
        )
    )
    where = {column[i].name(): i for i in range(column.shape[0])}
    return [(i, where[state[i].name()]) for i in range(state.shape[0]) if state[i].is_symbolic()]
