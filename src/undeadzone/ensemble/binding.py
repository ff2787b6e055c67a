"""From what varies to each run's own numbers: a scenario's [ensemble] bound to its loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.ensemble.addresses import quantities
from undeadzone.ensemble.uncertain import UncertainNumber, uncertain_numbers
from undeadzone.errors import InputError
from undeadzone.interfaces import graph_of
from undeadzone.linear import batched_hold
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.simulate import closed
from undeadzone.statistics import sampling
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, scalar


class Lanes(NamedTuple):
    """What each of several runs has for itself.

    Attributes:
        states: packed initial states (count x S)
        indices: the packed params that the runs have for themselves
        params: their values (count x P)
    """

    states: Floats
    indices: tuple[int, ...]
    params: Floats


class Sampled(NamedTuple):
    """A linear plant that is sampled anew for each run.

    Attributes:
        start: where it begins among the packed params
        AB: [A, B] (n x (n + m)) in continuous time
        Ts: sample time [s]
    """

    start: int
    AB: Floats
    Ts: float

    @property
    def slots(self) -> range:
        """Where [Ad, Bd] stands, column by column."""
        return range(self.start, self.start + self.AB.size)

    def values(self, own: dict[int, Floats], count: int) -> dict[int, Floats]:
        """[Ad, Bd] of `count` runs by slot, from the entries of [A, B] that are their own."""
        rows, columns = self.AB.shape
        AB = np.empty((rows, columns, count))
        for i, slot in enumerate(self.slots):
            row, column = i % rows, i // rows
            AB[row, column] = own.get(slot, self.AB[row, column])
        held = batched_hold.zoh(AB, self.Ts)
        return {slot: held[i % rows, i // rows] for i, slot in enumerate(self.slots)}


class Binding(NamedTuple):
    """What varies, bound to a loop.

    A run's numbers follow from the scenario, the seed and the number of the run alone.

    Attributes:
        columns: the numbers drawn for each run
        sampling: how they are drawn
        seed: of the draws
        state: the nominal initial state, packed
        params: the nominal params, packed
        indices: the packed params that differ between runs
        sampled: the plants that are sampled anew for each run
        copies: pairs (entry of the packed state, entry of the packed params that it starts from),
            where that one differs
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
        """The columns that are drawn, such as `sensor.right[0]`.

        The name of a column that holds factors on nominal values ends in (relative).
        """
        return [column.name for column in self.columns]

    def draw(self, first: int, count: int, runs: int) -> Floats:
        """The values that runs draw (count x columns).

        Args:
            first: number of the first run
            count: of the runs from there on
            runs: of the whole ensemble, on which some kinds of sampling depend

        Raises:
            InputError
        """
        u = sampling.points(self.sampling, self.seed, first, count, len(self.columns), runs)
        if not self.columns:
            return u
        values = [column.spread.quantile(u[:, i].copy()) for i, column in enumerate(self.columns)]
        return np.stack(values, axis=1)

    def lanes(self, values: Floats) -> Lanes:
        """The states and params of runs with these values (count x columns)."""
        count, size = len(values), self.params.size
        own: dict[int, Floats] = {}  # values (count) by slot of [params, state]
        for i, column in enumerate(self.columns):
            for slot, factor in column.slots:
                own[slot] = factor * values[:, i]
        for system in self.sampled:
            own |= system.values(own, count)
        states = np.repeat(self.state[None], count, axis=0)
        for entry, source in self.copies:
            states[:, entry] = own[source]
        for slot, numbers in own.items():
            if slot >= size:
                states[:, slot - size] = numbers
        params = np.empty((count, len(self.indices)))
        for k, i in enumerate(self.indices):
            params[:, k] = own.get(i, self.params[i])
        return Lanes(states, self.indices, params)

    def packed(self, values: Floats) -> tuple[Floats, Floats]:
        """(initial state, params), packed, of one run with these values (columns).

        They are the numbers of its lane, for any engine.
        """
        lane = self.lanes(np.asarray(values, float)[None])
        params = self.params.copy()
        params[list(self.indices)] = lane.params[0]
        return lane.states[0], params


def bind(problem: Problem, loop: Loop) -> Binding:
    """The scenario's [ensemble] bound to the loop of its problem.

    Args:
        problem: the scenario, checked and built
        loop: its loop, from `simulation.simulate.prepare` or `closed`

    Raises:
        InputError: by key of [ensemble]
    """
    vary = problem.scenario.ensemble
    if vary is None:
        raise InputError(
            "ensemble: missing; add a table [ensemble] with what varies, such as "
            '"sensor.right" = { uniform = [0.3, 2.0] }'
        )
    seed = _checked(vary, problem)
    columns = uncertain_numbers(vary.entries, quantities(problem, loop), problem)
    params = tree.pack(loop.params)
    state = tree.pack(loop.state._replace(plant=problem.x0))
    varied: set[int] = set()
    for column in columns:
        varied |= {slot for slot, _ in column.slots if slot < params.size}
    sampled = tuple(system for system in _sampled(problem, loop) if varied & set(system.slots))
    varied = varied.union(*(system.slots for system in sampled))
    copies = tuple(pair for pair in initial_copies(problem, loop) if pair[1] in varied)
    indices = tuple(sorted(varied))
    return Binding(columns, vary.sampling, seed, state, params, indices, sampled, copies)


def require_bound(scenario: Scenario) -> None:
    """Raise InputError for an [ensemble] that names what this scenario does not have."""
    if scenario.ensemble is None:
        return
    problem = resolve_scenario(scenario)
    if problem.observer.python is None:
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
    names = tree.names(loop.params)
    systems = {"plant.A[0,0]": problem.plant, "observer.model.A[0,0]": problem.model}
    linear = []
    for first, system in systems.items():
        if first in names and system.flow is not None and system.Ts is not None:
            AB = np.hstack([system.flow.A, system.flow.B])
            linear.append(Sampled(names.index(first), AB, system.Ts))
    return linear


def initial_copies(problem: Problem, loop: Loop) -> list[tuple[int, int]]:
    """Which numbers of the initial state are copies of params: pairs of entries (state, params)."""
    column, p = tree.symbols(loop.params, "p")
    initial = loop.state._replace(
        observer=graph_of(problem.observer).init(p.observer),
        controller=problem.controller.init(p.controller),
    )
    state = tree.stack(initial)
    where = {column[i].name(): i for i in range(column.shape[0])}
    return [(i, where[state[i].name()]) for i in range(state.shape[0]) if state[i].is_symbolic()]
