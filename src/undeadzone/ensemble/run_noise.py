"""What each run of an ensemble draws for itself along the way: noise, wear, lost readings, random disturbance, as its lane needs them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.engine import normal
from undeadzone.engine.lanes import Source, Supply
from undeadzone.ensemble.binding import Binding
from undeadzone.scenario.problem import Problem
from undeadzone.signals import noise
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation.loop import RUNGE_KUTTA, Loop
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers


class RandomDisturbance(NamedTuple):
    """A random disturbance: rms of each input, its colour, and the weights of a step's first and last knot in each entry."""

    rms: Floats
    colour: noise.Colour
    weights: tuple[tuple[float, float], ...]


class RunNoise(NamedTuple):
    """entries: of the exogenous inputs, first those made of the numbers of `words` (`noise.word`), then the disturbance at each instant.

    Of the former the last ones are the wear of edges, by `strides` each sample in logarithms, and readings lost with
    the probabilities `dropout`; the others are standard normal noise.
    """

    entries: tuple[int, ...]
    words: tuple[int, ...]
    strides: Floats
    dropout: Floats
    wind: RandomDisturbance | None
    seed: int

    def supply(self, runs: Integers) -> Supply | None:
        """The entries along the steps of runs given by number; None where there are none."""
        return (lambda lanes: _source(self, runs[lanes])) if self.entries else None


def drawn(problem: Problem, loop: Loop, binding: Binding) -> RunNoise:
    """What the runs of a bound ensemble draw."""
    places = {name: i for i, name in enumerate(tree.names(loop.instant))}
    slots = {name: i for i, name in enumerate(tree.names(loop.params))}
    entries, words = [], []
    for stream, name in ((noise.AFTER, "after"), (noise.BEFORE, "before")):
        for channel in range(problem.plant.p):
            slot = slots[f"scale.{name}[{channel}]"]
            if binding.params[slot] != 0 or slot in binding.indices:
                entries.append(places[f"{name}[{channel}]"])
                words.append(noise.word(stream, channel))
    sensor, p = problem.sensor, problem.plant.p
    for stream, name, used, first in (
        (noise.WEAR, "right", sensor.drift, 0),
        (noise.WEAR, "left", sensor.drift, p),
        (noise.LOSS, "lost", sensor.dropout, 0),
    ):
        for channel in np.flatnonzero(used).tolist():
            entries.append(places[f"{name}[{channel}]"])
            words.append(noise.word(stream, first + channel))
    wind = None
    if (random := inputs.random_disturbance(problem)) is not None:
        rms, correlation = random
        wind = RandomDisturbance(
            rms, noise.colour(correlation, problem.scenario.simulation.step), _weights(problem)
        )
        entries += [
            k * len(places) + places[f"w[{i}]"]
            for k in range(len(wind.weights))
            for i in range(rms.size)
        ]
    strides = inputs.strides(problem)
    return RunNoise(
        tuple(entries),
        tuple(words),
        strides[strides > 0],
        sensor.dropout[sensor.dropout > 0],
        wind,
        binding.seed,
    )


def _weights(problem: Problem) -> tuple[tuple[float, float], ...]:
    """At each instant of a step, or in each Taylor coefficient, of the straight line between two knots."""
    if problem.plant.Ts is not None:
        return ((0.5, 0.5),)
    if problem.scenario.simulation.order > RUNGE_KUTTA:
        return ((1.0, 0.0), (-1.0, 1.0))
    return tuple((1.0 - c, c) for c in inputs.INSTANTS)


def _source(own: RunNoise, runs: Integers) -> Source:
    """The entries of some runs, for steps asked for in order: (first step, steps) -> steps x entries x lanes."""
    wind, channels, held = own.wind, len(own.words), _held(own, runs)
    if wind is None:
        return held
    m = wind.rms.size
    words = [noise.word(noise.DISTURBANCE, i) for i in range(m)]
    state, last = np.empty((m, runs.size)), np.empty((m, runs.size))

    def windy(first: int, count: int) -> Floats:
        numbers = np.empty((count, len(own.entries), runs.size))
        if channels:
            numbers[:, :channels] = held(first, count)
        known = 1 if first else 0  # knots of the step that come from the steps before
        knots = np.empty((count + 1, m, runs.size))
        knots[:known] = last
        fresh = knots[known:]
        normal.fill(fresh, first + known, own.seed, words, runs)
        normal.colour(fresh, state, first + known, 0, *wind.colour)
        last[:] = knots[-1]
        knots = knots * wind.rms[:, None]
        for k, (first_weight, last_weight) in enumerate(wind.weights):
            numbers[:, channels + k * m : channels + (k + 1) * m] = (
                knots[:-1] * first_weight + knots[1:] * last_weight
            )
        return numbers

    return windy


def _held(own: RunNoise, runs: Integers) -> Source:
    """The entries made of the numbers of `words`, as `inputs.exogenous` makes them for one run."""
    channels, edges, losses = len(own.words), own.strides.size, own.dropout.size
    wear, missing = (
        slice(channels - losses - edges, channels - losses),
        slice(channels - losses, channels),
    )
    walk = np.zeros((edges, runs.size))

    def held(first: int, count: int) -> Floats:
        numbers = np.empty((count, channels, runs.size))
        normal.fill(numbers, first, own.seed, own.words, runs)
        if edges and count:
            moves = numbers[:, wear] * own.strides[:, None]
            moves[0] += walk
            moves = np.cumsum(moves, axis=0)
            walk[:] = moves[-1]
            numbers[:, wear] = inputs.worn(moves)
        if losses:
            numbers[:, missing] = inputs.lost(
                numbers[:, missing].swapaxes(1, 2), own.dropout
            ).swapaxes(1, 2)
        return numbers

    return held
