"""Runs of an ensemble with their signals.

The ensemble's own kernel moves the states, so that none differs by a bit.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import casadi as ca
import msgspec
import numpy as np

from undeadzone.engine import interpret, lanes
from undeadzone.ensemble.bands import EDGES, Bands, bands
from undeadzone.ensemble.batch import Batch
from undeadzone.errors import InputError
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem
from undeadzone.sensor import Zone
from undeadzone.simulation.collect import collect
from undeadzone.simulation.loop import Params
from undeadzone.simulation.simulate import named
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers

POINTS = 1000  # samples of a recorded trajectory, or a few more


def replay(batch: Batch, run: int) -> Run:
    """Run number `run` with all its signals. Raises InputError."""
    runs = batch.layout.runs
    if not 0 <= run < runs:
        raise InputError(f"run {run}: this ensemble has runs 0 to {runs - 1}")
    began = time.perf_counter()
    values = batch.binding.draw(run, 1, runs)
    everything = list(range(tree.size(batch.loop.outputs)))
    outputs = _recorded(batch, np.array([run]), values, everything, every=1)
    problem = _problem_of_run(batch, values[0], f"run {run}")
    return collect(problem, named(batch.loop, outputs[0]), None, began)


def recorded_bands(batch: Batch, runs: int, threads: int | None = None) -> Bands:
    """The bands of the first `runs` runs."""
    p = batch.problem.plant.p
    positions = [f"z[{i}]" for i in range(p)]
    edges: list[str] = []
    for i in range(p):
        edges += [f"{edge}[{i}]" for edge in EDGES]
    places = {name: i for i, name in enumerate(tree.names(batch.loop.outputs))}
    estimates = [f"estimate.{edge}" for edge in edges]
    wanted = [places[name] for name in (*positions, *estimates)]
    values = batch.binding.draw(0, runs, batch.layout.runs)
    every = max(1, len(batch.exogenous) // POINTS)
    outputs = _recorded(batch, np.arange(runs), values, wanted, every, threads)
    z, d_hat = outputs[:, :, :p], outputs[:, :, p:]
    t = batch.exogenous[::every, -2]
    params = np.array([batch.binding.packed(row)[1] for row in values])
    slots = {name: i for i, name in enumerate(tree.names(batch.loop.params))}
    widths = params[:, [slots[f"sensor.{edge}"] for edge in edges]]
    scale = params[:, slots["scale.reference"], None, None]
    r = scale * batch.problem.reference.value(t)
    return bands(t, z, r, d_hat, widths, batch.problem.tracked)


def _recorded(
    batch: Batch,
    runs: Integers,
    values: Floats,
    outputs: list[int],
    every: int,
    threads: int | None = None,
) -> Floats:
    """Some outputs of runs along their states (runs x N x chosen), on CasADi's virtual machine.

    Args:
        batch: the ensemble
        runs: their numbers
        values: of what varies (runs x columns)
        outputs: the chosen entries of the loop's packed outputs
        every: steps between two records
        threads: default one per processor
    """
    own = batch.binding.lanes(values)
    start = batch.started(own.states)
    trails, _ = lanes.run(
        _watched(batch.kernel, every),
        start,
        batch.exogenous,
        batch.params,
        batch.own.supply(runs),
        own.params,
        every=every,
        threads=threads,
    )
    instants = batch.exogenous[::every, :-2].copy()
    params = batch.binding.params.copy()
    step = batch.loop.step
    s, w, p = (ca.SX.sym(name, step.size1_in(i)) for i, name in enumerate("swp"))
    show = ca.Function("show", [ca.vertcat(s, w), p], [step(s, w, p)[1][outputs]])
    show_all = interpret.mapped(show, len(instants))
    shown = np.empty((len(runs), len(instants), len(outputs)))
    for lane, trail in enumerate(trails):
        states, _, drawn = np.split(trail, [s.numel(), start.shape[1]], axis=1)
        instants[:, batch.own.entries] = drawn
        params[list(own.indices)] = own.params[lane]
        shown[lane] = show_all(np.hstack([states, instants]), params)
    return shown


def _watched(kernel: lanes.Kernel, every: int) -> lanes.Kernel:
    """The kernel called for `every` steps at a time.

    It records its states and own inputs before each call.
    """
    shape = kernel.shape
    states, own = shape.sizes[0], len(shape.exogenous)

    def block(
        steps: int,
        width: int,
        work: Floats,
        exogenous: Floats,
        params: Floats,
        inputs: Floats,
        outputs: Floats,
    ) -> None:
        for k in range(0, steps, every):
            outputs[k, :states] = work[:states]
            outputs[k, states:] = inputs[k]
            count = min(every, steps - k)
            shared, drawn = exogenous[k : k + every], inputs[k : k + every]
            kernel.block(count, width, work, shared, params, drawn, outputs[:0])

    return kernel._replace(block=block, shape=shape._replace(record=tuple(range(states + own))))


def _problem_of_run(batch: Batch, values: Floats, what: str) -> Problem:
    """The problem as one run had it: its plant, its sensor and the size of its reference."""
    _, packed = batch.binding.packed(values)
    params: Params = tree.rebuild(batch.loop.params, _unpacked(batch.loop.params, packed))
    problem = batch.problem
    reference = problem.reference
    title = f"{problem.scenario.title}, {what}"
    return problem._replace(
        scenario=msgspec.structs.replace(problem.scenario, title=title),
        plant=problem.plant._replace(params=params.plant),
        sensor=_sensor_of_run(problem.sensor, params),
        reference=reference._replace(Q=reference.Q * params.scale.reference),
    )


def _sensor_of_run(sensor: Zone, params: Params) -> Zone:
    """The sensor with the numbers of one run."""
    changes = {"noise": params.scale.after, "noise_before": params.scale.before}
    numbers = params.sensor._asdict()
    limits = numbers.pop("limits")
    if limits is not None:
        changes |= limits._asdict()
    gaps = {side: numbers.pop(f"gap_{side}") for side in ("right", "left")}
    if sensor.play is not None:
        changes["play"] = sensor.play._replace(**gaps)
    for name, value in numbers.items():
        if value.size:
            changes[name] = value
    return msgspec.structs.replace(sensor, **changes)


def _unpacked(like: Any, numbers: Floats) -> Iterator[Floats]:
    """The parts of packed numbers in the shapes of a tree's leaves."""
    start = 0
    for _, leaf in tree.leaves(like):
        yield numbers[start : start + np.size(leaf)].reshape(np.shape(leaf), order="F")
        start += np.size(leaf)
