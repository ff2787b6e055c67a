"""What each run of an ensemble draws: noise, wear, lost readings, random disturbance."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from undeadzone.compile import normal
from undeadzone.compile.lanes import Source, Supply
from undeadzone.ensemble.binding import Binding
from undeadzone.scenario.problem import Problem
from undeadzone.signals import noise
from undeadzone.simulation import exogenous
from undeadzone.simulation.loop import RUNGE_KUTTA, Loop
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers


class RandomDisturbance(NamedTuple):
    """A random disturbance: a straight line between coloured knots at the ends of each step.

    Attributes:
        rms: of each input (m)
        colour: its colour
        weights: pairs (of a step's first knot, of its last one), one for each instant or Taylor
            coefficient that the loop takes per step
    """

    rms: Floats
    colour: noise.Colour
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
        """The entries along the steps of runs given by number; None where there are none."""
        if not self.entries:
            return None
        return lambda lanes: _source(self, runs[lanes])


def drawn(problem: Problem, loop: Loop, binding: Binding) -> RunNoise:
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
    """The word of each noise of the sensor that any run has, by exogenous input."""
    slots = {name: i for i, name in enumerate(tree.names(loop.params))}
    words = {}
    for stream, name in ((noise.AFTER, "after"), (noise.BEFORE, "before")):
        for channel in range(problem.plant.p):
            slot = slots[f"scale.{name}[{channel}]"]
            if binding.params[slot] != 0 or slot in binding.indices:
                words[f"{name}[{channel}]"] = noise.word(stream, channel)
    return words


def _sensor_streams(problem: Problem) -> dict[str, int]:
    """The word of each worn edge, then of each reading that may be lost, by exogenous input."""
    sensor, p = problem.sensor, problem.plant.p
    words = {}
    for channel in np.flatnonzero(sensor.drift).tolist():
        words[f"right[{channel}]"] = noise.word(noise.WEAR, channel)
    for channel in np.flatnonzero(sensor.drift).tolist():
        words[f"left[{channel}]"] = noise.word(noise.WEAR, p + channel)
    for channel in np.flatnonzero(sensor.dropout).tolist():
        words[f"lost[{channel}]"] = noise.word(noise.LOSS, channel)
    return words


def _random_disturbance(problem: Problem) -> RandomDisturbance | None:
    """The random disturbance of a problem, if it has one."""
    random = exogenous.random_disturbance(problem)
    if random is None:
        return None
    rms, correlation_time = random
    colour = noise.colour(correlation_time, problem.scenario.simulation.step)
    return RandomDisturbance(rms, colour, _weights(problem))


def _weights(problem: Problem) -> tuple[tuple[float, float], ...]:
    """The weights (`RandomDisturbance`) of the straight line between two knots."""
    if problem.plant.Ts is not None:
        return ((0.5, 0.5),)
    if problem.scenario.simulation.order > RUNGE_KUTTA:
        return ((1.0, 0.0), (-1.0, 1.0))
    return tuple((1.0 - c, c) for c in exogenous.INSTANTS)


def _source(own: RunNoise, runs: Integers) -> Source:
    """The entries of some runs (steps x entries x lanes), for steps asked for in order."""
    from_words = _source_of_words(own, runs)
    if own.disturbance is None:
        return from_words
    channels = len(own.words)
    fill_disturbance = _disturbance_filler(own.disturbance, own.seed, runs)

    def source(first: int, count: int) -> Floats:
        numbers = np.empty((count, len(own.entries), runs.size))
        if channels:
            numbers[:, :channels] = from_words(first, count)
        fill_disturbance(numbers[:, channels:], first)
        return numbers

    return source


def _disturbance_filler(
    disturbance: RandomDisturbance, seed: int, runs: Integers
) -> Callable[[Floats, int], None]:
    """A function of (numbers, first step) that fills steps asked for in order.

    numbers (steps x entries x lanes) get the disturbance at all of its instants, one after the
    other.
    """
    m = disturbance.rms.size
    words = [noise.word(noise.DISTURBANCE, i) for i in range(m)]
    state = np.empty((m, runs.size))  # of the colouring filter
    last = np.empty((m, runs.size))  # the last knot of the steps before

    def fill(numbers: Floats, first: int) -> None:
        known = 1 if first else 0  # knots of the step that come from the steps before
        knots = np.empty((len(numbers) + 1, m, runs.size))
        knots[:known] = last
        fresh = knots[known:]
        normal.fill(fresh, first + known, seed, words, runs)
        normal.colour(fresh, state, first + known, 0, *disturbance.colour)
        last[:] = knots[-1]
        knots = knots * disturbance.rms[:, None]
        for k, (a, b) in enumerate(disturbance.weights):
            numbers[:, k * m : (k + 1) * m] = knots[:-1] * a + knots[1:] * b

    return fill


def _source_of_words(own: RunNoise, runs: Integers) -> Source:
    """The entries made of `words`, as `simulation.exogenous` makes them for one run."""
    channels, edges, losses = len(own.words), own.strides.size, own.dropout.size
    wear = slice(channels - losses - edges, channels - losses)
    lost = slice(channels - losses, channels)
    walk = np.zeros((edges, runs.size))  # of each edge, in logarithms, up to the steps asked for

    def source(first: int, count: int) -> Floats:
        numbers = np.empty((count, channels, runs.size))
        normal.fill(numbers, first, own.seed, own.words, runs)
        if edges and count:
            moves = numbers[:, wear] * own.strides[:, None]
            moves[0] += walk
            moves = np.cumsum(moves, axis=0)
            walk[:] = moves[-1]
            numbers[:, wear] = exogenous.worn(moves)
        if losses:
            normals = numbers[:, lost].swapaxes(1, 2)
            numbers[:, lost] = exogenous.lost(normals, own.dropout).swapaxes(1, 2)
        return numbers

    return source
