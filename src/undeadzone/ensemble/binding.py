"""What each run has for itself, its numbers and its noise: [ensemble] bound to a loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.compile import normal
from undeadzone.compile.lanes import Source, Supply
from undeadzone.ensemble.varied import UncertainNumber, quantities, uncertain_numbers
from undeadzone.errors import InputError
from undeadzone.interfaces import require_graph
from undeadzone.linalg.hold import zoh_of_each
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals import noise
from undeadzone.simulation import exogenous
from undeadzone.simulation.loop import RUNGE_KUTTA, Loop
from undeadzone.simulation.simulate import close_problem
from undeadzone.statistics import sampling
from undeadzone.util import tree
from undeadzone.util.arrays import Floats, Integers, scalar, seed_of


class Lanes(NamedTuple):
    """What each of several runs has for itself.

    Attributes:
        states: packed initial states (count x S)
        params: values of the packed params that the runs have for themselves (count x P)
    """

    states: Floats
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
        """Return [Ad, Bd] of `count` runs by slot, from the entries of [A, B] that are their
        own.
        """
        rows, columns = self.AB.shape
        AB = np.empty((rows, columns, count))
        for i, slot in enumerate(self.slots):
            row, column = i % rows, i // rows
            AB[row, column] = own.get(slot, self.AB[row, column])
        held = zoh_of_each(AB, self.Ts)
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
        """Return the columns that are drawn, such as `sensor.right[0]`.

        The name of a column that holds factors on nominal values ends in (relative).
        """
        return [column.name for column in self.columns]

    def draw(self, first: int, count: int, runs: int) -> Floats:
        """Return the values that runs draw (count x columns).

        Args:
            first: number of the first run
            count: of the runs from there on
            runs: of the whole ensemble, on which some kinds of sampling depend

        Raises:
            InputError
        """
        u = sampling.design_points(self.sampling, self.seed, first, count, len(self.columns), runs)
        if not self.columns:
            return u
        values = [column.spread.quantile(u[:, i].copy()) for i, column in enumerate(self.columns)]
        return np.stack(values, axis=1)

    def lanes(self, values: Floats) -> Lanes:
        """Return the states and params of runs with these values (count x columns)."""
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
        return Lanes(states, params)

    def pack_run(self, values: Floats) -> tuple[Floats, Floats]:
        """Return (initial state, params), packed, of one run with these values (columns).

        They are the numbers of its lane, for any engine.
        """
        lane = self.lanes(np.asarray(values, float)[None])
        params = self.params.copy()
        params[list(self.indices)] = lane.params[0]
        return lane.states[0], params


def bind(problem: Problem, loop: Loop) -> Binding:
    """Return the scenario's [ensemble] bound to the loop of its problem.

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
    seed = _require_seed(vary, problem)
    params, held = tree.pack(loop.params), _sampled_plants(problem, loop)
    nominal = params.copy()
    for system in held:
        nominal[list(system.slots)] = system.AB.ravel(order="F")
    columns = uncertain_numbers(vary.entries, quantities(problem, loop, nominal), problem)
    state = tree.pack(loop.state._replace(plant=problem.x0))
    varied: set[int] = set()
    for column in columns:
        varied |= {slot for slot, _ in column.slots if slot < params.size}
    sampled = tuple(system for system in held if varied & set(system.slots))
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
        bind(problem, close_problem(problem))


def _require_seed(vary: Vary, problem: Problem) -> int:
    """Return the seed. Raises InputError."""
    seed = problem.scenario.simulation.seed if vary.seed is None else vary.seed
    if vary.runs < 1:
        raise InputError(f"ensemble.runs: expected 1 or more, found {vary.runs}")
    scalar("ensemble.tolerance", vary.tolerance, above=0.0)
    return seed_of("ensemble.seed", seed)


def _sampled_plants(problem: Problem, loop: Loop) -> list[Sampled]:
    """Return the linear plants that the loop holds in sampled form."""
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
        observer=require_graph(problem.observer).init(p.observer),
        controller=problem.controller.init(p.controller),
    )
    state = tree.stack(initial)
    where = {column[i].name(): i for i in range(column.shape[0])}
    return [(i, where[state[i].name()]) for i in range(state.shape[0]) if state[i].is_symbolic()]


class RandomDisturbance(NamedTuple):
    """A random disturbance: a straight line between coloured knots at the ends of each step.

    Attributes:
        rms: of each input (m)
        colour: its colour
        weights: pairs (of a step's first knot, of its last one), one for each instant or Taylor
            coefficient that the loop takes per step
    """

    rms: Floats
    colour: noise.FirstOrderNoise
    weights: tuple[tuple[float, float], ...]


class RunNoise(NamedTuple):
    """Which exogenous inputs each run draws for itself, and from what.

    Attributes:
        entries: places among the exogenous inputs: first one for each of `words`, then the
            disturbance at each of its instants
        words: random streams (`noise.word`): standard normal noise, then wear of edges, then lost
            readings
        strides: the wear of each worn edge per sample, in logarithms
        dropout: the probability of each reading that may be lost
        disturbance: None where there is none, or it is not random
        seed: of all draws
    """

    entries: tuple[int, ...]
    words: tuple[int, ...]
    strides: Floats
    dropout: Floats
    disturbance: RandomDisturbance | None
    seed: int

    def supply(self, runs: Integers) -> Supply | None:
        """Return the entries along the steps of runs given by number; None where there are none."""
        if not self.entries:
            return None
        return lambda lanes: _source(self, runs[lanes])


def draw_values(problem: Problem, loop: Loop, binding: Binding) -> RunNoise:
    """What the runs of a bound ensemble draw."""
    places = {name: i for i, name in enumerate(tree.names(loop.instant))}
    streams = _noise_streams(problem, loop, binding) | _sensor_streams(problem)
    entries = [places[name] for name in streams]
    disturbance = _random_disturbance(problem)
    if disturbance is not None:
        for k in range(len(disturbance.weights)):
            for i in range(disturbance.rms.size):
                entries.append(k * len(places) + places[f"w[{i}]"])
    strides, dropout = exogenous.strides(problem), problem.sensor.dropout
    return RunNoise(
        entries=tuple(entries),
        words=tuple(streams.values()),
        strides=strides[strides > 0],
        dropout=dropout[dropout > 0],
        disturbance=disturbance,
        seed=binding.seed,
    )


def _noise_streams(problem: Problem, loop: Loop, binding: Binding) -> dict[str, int]:
    """Return the word of each noise of the sensor that any run has, by exogenous input."""
    slots = {name: i for i, name in enumerate(tree.names(loop.params))}
    words = {}
    for stream, name in ((noise.AFTER, "after"), (noise.BEFORE, "before")):
        for channel in range(problem.plant.p):
            slot = slots[f"scale.{name}[{channel}]"]
            if binding.params[slot] != 0 or slot in binding.indices:
                words[f"{name}[{channel}]"] = noise.counter_word(stream, channel)
    return words


def _sensor_streams(problem: Problem) -> dict[str, int]:
    """Return the word of each worn edge, then of each reading that may be lost, by exogenous
    input.
    """
    sensor, p = problem.sensor, problem.plant.p
    wear, loss = (noise.WEAR, sensor.drift), (noise.LOSS, sensor.dropout)
    words = {}
    for name, first, (stream, has) in (("right", 0, wear), ("left", p, wear), ("lost", 0, loss)):
        for channel in np.flatnonzero(has).tolist():
            words[f"{name}[{channel}]"] = noise.counter_word(stream, first + channel)
    return words


def _random_disturbance(problem: Problem) -> RandomDisturbance | None:
    """Return the random disturbance of a problem, if it has one."""
    random = exogenous.random_disturbance(problem)
    if random is None:
        return None
    rms, correlation_time = random
    colour = noise.first_order_coefficients(correlation_time, problem.scenario.simulation.step)
    return RandomDisturbance(rms, colour, _weights(problem))


def _weights(problem: Problem) -> tuple[tuple[float, float], ...]:
    """Return the weights (`RandomDisturbance`) of the straight line between two knots."""
    if problem.plant.Ts is not None:
        return ((0.5, 0.5),)
    if problem.scenario.simulation.order > RUNGE_KUTTA:
        return ((1.0, 0.0), (-1.0, 1.0))
    return tuple((1.0 - c, c) for c in exogenous.INSTANTS)


def _source(own: RunNoise, runs: Integers) -> Source:
    """Return the entries of some runs (steps x entries x lanes), for steps asked for in order."""
    if own.disturbance is None:
        return _source_of_words(own, runs)
    disturbance = _source_of_disturbance(own.disturbance, own.seed, runs)
    if not own.words:
        return disturbance
    parts = (_source_of_words(own, runs), disturbance)
    return lambda first, count: np.concatenate([part(first, count) for part in parts], axis=1)


def _source_of_disturbance(disturbance: RandomDisturbance, seed: int, runs: Integers) -> Source:
    """Return the disturbance at all of its instants, one after the other, for steps asked for in
    order.
    """
    m = disturbance.rms.size
    words = [noise.counter_word(noise.DISTURBANCE, i) for i in range(m)]
    state = np.empty((m, runs.size))  # of the colouring filter
    last = np.empty((m, runs.size))  # the last knot of the steps before

    def source(first: int, count: int) -> Floats:
        known = 1 if first else 0  # knots of the step that come from the steps before
        knots = np.empty((count + 1, m, runs.size))
        knots[:known] = last
        fresh = knots[known:]
        normal.fill_normal(fresh, first + known, seed, words, runs)
        normal.colour_noise(fresh, state, first + known, *disturbance.colour)
        last[:] = knots[-1]
        knots = knots * disturbance.rms[:, None]
        along = [knots[:-1] * a + knots[1:] * b for a, b in disturbance.weights]
        return np.concatenate(along, axis=1)

    return source


def _source_of_words(own: RunNoise, runs: Integers) -> Source:
    """Return the entries made of `words`, as `simulation.exogenous` makes them for one run."""
    channels, edges, losses = len(own.words), own.strides.size, own.dropout.size
    wear = slice(channels - losses - edges, channels - losses)
    lost = slice(channels - losses, channels)
    walk = np.zeros((edges, runs.size))  # of each edge, in logarithms, up to the steps asked for

    def source(first: int, count: int) -> Floats:
        numbers = np.empty((count, channels, runs.size))
        normal.fill_normal(numbers, first, own.seed, own.words, runs)
        if edges and count:
            moves = numbers[:, wear] * own.strides[:, None]
            moves[0] += walk
            moves = np.cumsum(moves, axis=0)
            walk[:] = moves[-1]
            numbers[:, wear] = exogenous.width_drift(moves)
        if losses:
            normals = numbers[:, lost].swapaxes(1, 2)
            numbers[:, lost] = exogenous.lost(normals, own.dropout).swapaxes(1, 2)
        return numbers

    return source
