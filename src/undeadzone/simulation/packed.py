"""Packed numbers of a loop or a filter: those that a change moves, and those of each lane."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.interfaces import Reading, require_graph
from undeadzone.linalg.hold import zoh_of_each
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.close import loop_numbers, no_target
from undeadzone.simulation.loop import Loop
from undeadzone.util import tree
from undeadzone.util.arrays import Floats, Integers


class Lanes(NamedTuple):
    """States, params and exogenous inputs of each of several runs.

    Attributes:
        states: packed initial states (count x S)
        params: values of the packed params that the runs have for themselves (count x P)
    """

    states: Floats
    params: Floats


class ResampledPlant(NamedTuple):
    """Linear plant that is sampled anew for each run.

    Attributes:
        start: its first place among the packed params
        AB: [A, B] (n x (n + m)) in continuous time
        Ts: sample time [s]
    """

    start: int
    AB: Floats
    Ts: float

    @property
    def param_slots(self) -> range:
        """Return the slots of [Ad, Bd] in the packed params, column by column."""
        return range(self.start, self.start + self.AB.size)

    def discretise_runs(self, own: dict[int, Floats], count: int) -> dict[int, Floats]:
        """Return [Ad, Bd] of `count` runs by slot, from the entries of [A, B] that vary by
        run.
        """
        rows, columns = self.AB.shape
        AB = np.empty((rows, columns, count))
        for i, slot in enumerate(self.param_slots):
            row = i % rows
            column = i // rows
            AB[row, column] = own.get(slot, self.AB[row, column])
        discretised = zoh_of_each(AB, self.Ts)
        return {slot: discretised[i % rows, i // rows] for i, slot in enumerate(self.param_slots)}


class BoundNumbers(NamedTuple):
    """Numbers of a scenario, bound to the packed params and state of a graph.

    A number may stand in several places, and a linear plant is sampled anew for each lane.

    Attributes:
        slots: of each number, pairs (slot of the packed [params, state], factor) (it sets each slot
            to the factor times its value)
        state: the nominal initial state, packed
        params: the nominal params, packed
        indices: the packed params that differ between lanes
        sampled: the plants that are sampled anew for each lane
        copies: pairs (entry of the packed state, entry of the packed params that it starts from),
            where that one differs
    """

    slots: tuple[tuple[tuple[int, float], ...], ...]
    state: Floats
    params: Floats
    indices: tuple[int, ...]
    sampled: tuple[ResampledPlant, ...] = ()
    copies: tuple[tuple[int, int], ...] = ()

    def to_lanes(self, values: Floats, computed: dict[int, Floats] | None = None) -> Lanes:
        """Return the states and params of lanes with these values (count x numbers).

        Args:
            values: of the numbers.
            computed: values (count) by slot that follow from them in another way (None: none).
        """
        count = len(values)
        size = self.params.size
        own = dict(computed or {})  # values (count) by slot of [params, state]
        for i, slots in enumerate(self.slots):
            for slot, factor in slots:
                own[slot] = factor * values[:, i]
        for system in self.sampled:
            own |= system.discretise_runs(own, count)
        states = np.repeat(self.state[None], count, axis=0)
        for entry, source in self.copies:
            states[:, entry] = own[source]
        for slot, numbers in own.items():
            if slot >= size:
                states[:, slot - size] = numbers
        params = np.empty((count, len(self.indices)))
        for k, i in enumerate(self.indices):
            params[:, k] = own.get(i, self.params[i])
        return Lanes(states, params)

    def pack_lane(self, values: Floats) -> tuple[Floats, Floats]:
        """Return the initial state and the params, packed, of a lane with these values."""
        lane = self.to_lanes(np.asarray(values, float)[None])
        params = self.params.copy()
        params[list(self.indices)] = lane.params[0]
        return lane.states[0], params


def bind_numbers(
    slots: Iterable[tuple[tuple[int, float], ...]],
    state: Floats,
    params: Floats,
    plants: Iterable[ResampledPlant],
    copies: Iterable[tuple[int, int]] = (),
    computed: Iterable[int] = (),
) -> BoundNumbers:
    """Return numbers bound to packed params and state.

    Args:
        slots, state, params: as those of `BoundNumbers`.
        plants: linear plants in sampled form. Those with a slot that varies are sampled anew.
        copies: pairs (entry of the packed state, entry of the packed params that it copies).
        computed: slots that vary besides.
    """
    slots = tuple(slots)
    every = {slot for slot, _ in itertools.chain(*slots)}
    varied = every.intersection(range(params.size)).union(computed)
    sampled = tuple(system for system in plants if varied & set(system.param_slots))
    varied = varied.union(*(system.param_slots for system in sampled))
    copied = tuple(pair for pair in copies if pair[1] in varied)
    return BoundNumbers(slots, state, params, tuple(sorted(varied)), sampled, copied)


def pack_problem(problem: Problem, loop: Loop) -> tuple[Floats, Floats]:
    """Return (initial state, params), packed, that a problem gives a loop of its graph.

    Args:
        problem: the numbers' own.
        loop: of a problem with the same `graph`.

    Raises:
        InputError: the observer is not a graph.
    """
    observer = require_graph(problem.observer)
    controller = problem.controller
    state = loop.state._replace(
        plant=problem.x0,
        observer=observer.init(observer.params),
        controller=controller.init(controller.params),
    )
    return tree.pack_tree(state), tree.pack_tree(loop_numbers(problem._replace(observer=observer)))


def changed_params(loop: Loop, others: Iterable[Floats]) -> Integers:
    """Return the places at which packed params of the loop differ from those of any other loop."""
    differ: Any = np.any([other != tree.pack_tree(loop.params) for other in others], axis=0)
    return np.flatnonzero(differ)


def graph(problem: Problem) -> str:
    """Return observer and controller without their numbers, but with those of a plan, as text.

    It is equal for problems that one kernel serves.

    Args:
        problem: the checked parts of a scenario.

    Raises:
        InputError: there is no graph.
    """
    observer = require_graph(problem.observer)
    controller = problem.controller
    model = problem.model
    p_column, p = tree.create_symbols((observer.params, controller.params), "p")
    like = observer.init(observer.params), controller.init(controller.params)
    s_column, s = tree.create_symbols(like, "s")
    t_column, target = tree.create_symbols(no_target(problem), "t")
    u = ca.SX.sym("u", model.m)
    y = ca.SX.sym("y", model.p)
    side = ca.SX.sym("side", model.p)
    x = ca.SX.sym("x", model.n)
    following, estimate = observer.step(p[0], s[0], u, Reading(y, side, x))
    results = (
        following,
        estimate,
        observer.project(p[0], s[0]),
        observer.init(p[0]),
        controller.step(p[1], s[1], estimate, target),
        controller.init(p[1]),
    )
    inputs = [p_column, s_column, t_column, u, y, side, x]
    function = ca.Function("graph", inputs, list(map(tree.stack_leaves, results)))
    plan = () if controller.plan is None else tree.pack_tree(controller.plan.params).tolist()
    return str(function.serialize()) + str((tree.number_addresses((observer.params, like)), plan))
