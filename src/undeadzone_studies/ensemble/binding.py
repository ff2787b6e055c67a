"""Parameters and noise of each run: [ensemble] bound to a loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.compile import normal
from undeadzone.compile.lanes import Source, Supply
from undeadzone.errors import InputError
from undeadzone.interfaces import require_graph
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.signals import noise
from undeadzone.simulation import exogenous
from undeadzone.simulation.loop import RUNGE_KUTTA, Loop
from undeadzone.simulation.packed import BoundNumbers, ResampledPlant, bind_numbers
from undeadzone.simulation.simulate import close_problem
from undeadzone.util import tree
from undeadzone.util.arrays import Floats, Integers, require_number, require_seed
from undeadzone_studies.ensemble.varied import UncertainNumber, collect_quantities, resolve_entries
from undeadzone_studies.statistics import sampling


class Binding(NamedTuple):
    """Uncertain parameters of an ensemble, bound to a loop.

    A run's numbers follow from the scenario, the seed and the number of the run alone.

    Attributes:
        columns: the numbers drawn for each run
        sampling: how they are drawn
        seed: of the draws
        numbers: the same, bound to the packed numbers of the loop
    """

    columns: tuple[UncertainNumber, ...]
    sampling: str
    seed: int
    numbers: BoundNumbers

    @property
    def names_of_columns(self) -> list[str]:
        """Return the names of the drawn columns, such as `sensor.right[0]`.

        The name of a column that holds factors on nominal values ends in (relative).
        """
        return [column.name for column in self.columns]

    def draw_columns(self, first: int, count: int, runs: int) -> Floats:
        """Return the drawn values of runs (count x columns).

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


def bind_ensemble(problem: Problem, loop: Loop) -> Binding:
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
            "ensemble: missing. Add a table [ensemble] with what varies, such as "
            '"sensor.right" = { uniform = [0.3, 2.0] }'
        )
    seed = _require_seed(vary, problem)
    params = tree.pack_tree(loop.params)
    sampled_plants = _collect_sampled_plants(problem, loop)
    nominal = params.copy()
    for system in sampled_plants:
        nominal[list(system.param_slots)] = system.AB.ravel(order="F")
    columns = resolve_entries(vary.entries, collect_quantities(problem, loop, nominal), problem)
    state = tree.pack_tree(loop.state._replace(plant=problem.x0))
    slots = [column.slots for column in columns]
    numbers = bind_numbers(slots, state, params, sampled_plants, initial_copies(problem, loop))
    return Binding(columns, vary.sampling, seed, numbers)


def require_bound(scenario: Scenario) -> None:
    """Raise InputError for an [ensemble] with addresses that this scenario does not have."""
    if scenario.ensemble is None:
        return
    problem = resolve_scenario(scenario)
    if problem.observer.python is None:
        bind_ensemble(problem, close_problem(problem))


def _require_seed(vary: Vary, problem: Problem) -> int:
    """Return the seed. Raises InputError."""
    seed = problem.scenario.simulation.seed if vary.seed is None else vary.seed
    if vary.runs < 1:
        raise InputError(f"ensemble.runs: expected 1 or more, found {vary.runs}")
    require_number("ensemble.tolerance", vary.tolerance, above=0.0)
    return require_seed("ensemble.seed", seed)


def _collect_sampled_plants(problem: Problem, loop: Loop) -> list[ResampledPlant]:
    """Return the linear plants that the loop contains in sampled form."""
    names = tree.number_addresses(loop.params)
    systems = {"plant.A[0,0]": problem.plant, "observer.model.A[0,0]": problem.model}
    linear = []
    for first, system in systems.items():
        if first in names and system.flow is not None and system.Ts is not None:
            AB = np.hstack([system.flow.A, system.flow.B])
            linear.append(ResampledPlant(names.index(first), AB, system.Ts))
    return linear


def initial_copies(problem: Problem, loop: Loop) -> list[tuple[int, int]]:
    """Return the entries of the initial state that are copies of params, as pairs (state,
    params).
    """
    column, p = tree.create_symbols(loop.params, "p")
    initial = loop.state._replace(
        observer=require_graph(problem.observer).init(p.observer),
        controller=problem.controller.init(p.controller),
    )
    state = tree.stack_leaves(initial)
    where = {column[i].name(): i for i in range(column.shape[0])}
    return [(i, where[state[i].name()]) for i in range(state.shape[0]) if state[i].is_symbolic()]


class RandomDisturbance(NamedTuple):
    """Random disturbance: a straight line between coloured knots at the ends of each step.

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
    """Exogenous inputs that each run draws for itself, and their random streams.

    Attributes:
        entries: places among the exogenous inputs: first one for each of `words`, then the
            disturbance at each of its instants
        words: random streams (`noise.word`): standard normal noise, then wear of edges, then lost
            readings
        wear_deviations: standard deviation of the increment of log width per sample, worn edges
        dropout: the probability of each reading that may be lost
        disturbance: None if absent or not random
        seed: of all draws
    """

    entries: tuple[int, ...]
    words: tuple[int, ...]
    wear_deviations: Floats
    dropout: Floats
    disturbance: RandomDisturbance | None
    seed: int

    def noise_supply(self, runs: Integers) -> Supply | None:
        """Return the source of the entries along the steps of runs given by number, or
        None without entries.
        """
        if not self.entries:
            return None
        return lambda lanes: _build_source(self, runs[lanes])


def build_run_noise(problem: Problem, loop: Loop, binding: Binding) -> RunNoise:
    """Return the random streams of the runs of a bound ensemble."""
    places = {name: i for i, name in enumerate(tree.number_addresses(loop.instant))}
    streams = _noise_streams(problem, loop, binding) | _sensor_streams(problem)
    entries = [places[name] for name in streams]
    disturbance = _find_random_disturbance(problem)
    if disturbance is not None:
        for k in range(len(disturbance.weights)):
            for i in range(disturbance.rms.size):
                entries.append(k * len(places) + places[f"w[{i}]"])
    wear_deviations = exogenous.wear_deviations(problem)
    dropout = problem.sensor.dropout
    return RunNoise(
        entries=tuple(entries),
        words=tuple(streams.values()),
        wear_deviations=wear_deviations[wear_deviations > 0],
        dropout=dropout[dropout > 0],
        disturbance=disturbance,
        seed=binding.seed,
    )


def _noise_streams(problem: Problem, loop: Loop, binding: Binding) -> dict[str, int]:
    """Return the counter word of each sensor noise that any run has, by exogenous input."""
    slots = {name: i for i, name in enumerate(tree.number_addresses(loop.params))}
    words = {}
    for stream, name in ((noise.AFTER, "after"), (noise.BEFORE, "before")):
        for channel in range(problem.plant.p):
            slot = slots[f"scale.{name}[{channel}]"]
            if binding.numbers.params[slot] != 0 or slot in binding.numbers.indices:
                words[f"{name}[{channel}]"] = noise.counter_word(stream, channel)
    return words


def _sensor_streams(problem: Problem) -> dict[str, int]:
    """Return the counter words of drifting widths, then of lossy readings, by exogenous input."""
    sensor = problem.sensor
    p = problem.plant.p
    wear = (noise.WEAR, sensor.drift)
    loss = (noise.LOSS, sensor.dropout)
    words = {}
    for name, first, (stream, has) in (("right", 0, wear), ("left", p, wear), ("lost", 0, loss)):
        for channel in np.flatnonzero(has).tolist():
            words[f"{name}[{channel}]"] = noise.counter_word(stream, first + channel)
    return words


def _find_random_disturbance(problem: Problem) -> RandomDisturbance | None:
    """Return the random disturbance of a problem, or None."""
    random = exogenous.random_disturbance(problem)
    if random is None:
        return None
    rms, correlation_time = random
    colour = noise.first_order_coefficients(correlation_time, problem.scenario.simulation.step)
    return RandomDisturbance(rms, colour, _knot_weights(problem))


def _knot_weights(problem: Problem) -> tuple[tuple[float, float], ...]:
    """Return the weights (`RandomDisturbance`) of the straight line between two knots."""
    if problem.plant.Ts is not None:
        return ((0.5, 0.5),)
    if problem.scenario.simulation.order > RUNGE_KUTTA:
        return ((1.0, 0.0), (-1.0, 1.0))
    return tuple((1.0 - c, c) for c in exogenous.INSTANTS)


def _build_source(own: RunNoise, runs: Integers) -> Source:
    """Return the source of the entries of some runs (steps x entries x lanes), for steps read
    in order.
    """
    if own.disturbance is None:
        return _build_stream_source(own, runs)
    disturbance = _build_disturbance_source(own.disturbance, own.seed, runs)
    if not own.words:
        return disturbance
    parts = (_build_stream_source(own, runs), disturbance)
    return lambda first, count: np.concatenate([part(first, count) for part in parts], axis=1)


def _build_disturbance_source(disturbance: RandomDisturbance, seed: int, runs: Integers) -> Source:
    """Return the source of the disturbance at all of its instants, for steps read in order."""
    m = disturbance.rms.size
    words = [noise.counter_word(noise.DISTURBANCE, i) for i in range(m)]
    state = np.empty((m, runs.size))  # of the colouring filter
    last = np.empty((m, runs.size))  # the last knot of the steps before

    def source(first: int, count: int) -> Floats:
        """Return the disturbance of the next `count` steps."""
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


def _build_stream_source(own: RunNoise, runs: Integers) -> Source:
    """Return the source of the entries of `words`, as `simulation.exogenous` computes for a
    run.
    """
    channels = len(own.words)
    edges = own.wear_deviations.size
    losses = own.dropout.size
    wear = slice(channels - losses - edges, channels - losses)
    lost = slice(channels - losses, channels)
    walk = np.zeros((edges, runs.size))  # of each edge, in logarithms, up to the requested steps

    def source(first: int, count: int) -> Floats:
        """Return the noise, drift and lost readings of the next `count` steps."""
        numbers = np.empty((count, channels, runs.size))
        normal.fill_normal(numbers, first, own.seed, own.words, runs)
        if edges and count:
            moves = numbers[:, wear] * own.wear_deviations[:, None]
            moves[0] += walk
            moves = np.cumsum(moves, axis=0)
            walk[:] = moves[-1]
            numbers[:, wear] = exogenous.width_drift(moves)
        if losses:
            normals = numbers[:, lost].swapaxes(1, 2)
            numbers[:, lost] = exogenous.missing_mask(normals, own.dropout).swapaxes(1, 2)
        return numbers

    return source
