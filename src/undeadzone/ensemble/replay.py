"""Runs of an ensemble with their signals: the kernel of the ensemble itself moves the states, so that none differs by a bit."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import casadi as ca
import msgspec
import numpy as np

from undeadzone.engine import interpret, lanes
from undeadzone.ensemble.bands import Bands, bands
from undeadzone.ensemble.batch import Batch
from undeadzone.errors import InputError
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.collect import collect
from undeadzone.simulation.loop import Params
from undeadzone.simulation.run import Run
from undeadzone.simulation.simulate import named
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers

POINTS = 1000  # samples of a recorded trajectory, or a few more


def replay(fleet: Batch, run: int) -> Run:
    """Run number `run` with all its signals. Raises InputError."""
    if not 0 <= run < fleet.layout.runs:
        raise InputError(f"run {run}: this ensemble has runs 0 to {fleet.layout.runs - 1}")
    began = time.perf_counter()
    values = fleet.binding.draw(run, 1, fleet.layout.runs)
    outputs = _recorded(
        fleet, np.array([run]), values, list(range(tree.size(fleet.loop.outputs))), 1
    )
    return collect(
        _problem(fleet, values[0], f"run {run}"), named(fleet.loop, outputs[0]), None, began
    )


def recorded_bands(fleet: Batch, runs: int, threads: int | None = None) -> Bands:
    """The bands of the first `runs` runs."""
    p = fleet.problem.plant.p
    values = fleet.binding.draw(0, runs, fleet.layout.runs)
    places = {name: i for i, name in enumerate(tree.names(fleet.loop.outputs))}
    wanted = [places[f"z[{i}]"] for i in range(p)] + [
        places[f"estimate.{edge}[{i}]"] for i in range(p) for edge in ("right", "left")
    ]
    every = max(1, len(fleet.exogenous) // POINTS)
    outputs = _recorded(fleet, np.arange(runs), values, wanted, every, threads)
    t = fleet.exogenous[::every, -2]
    params = np.array([fleet.binding.packed(row)[1] for row in values])
    slots = {name: i for i, name in enumerate(tree.names(fleet.loop.params))}
    widths = params[
        :, [slots[f"sensor.{edge}[{i}]"] for i in range(p) for edge in ("right", "left")]
    ]
    r = params[:, slots["scale.reference"], None, None] * fleet.problem.reference.value(t)
    return bands(t, outputs[:, :, :p], r, outputs[:, :, p:], widths, fleet.problem.tracked)


def _recorded(
    fleet: Batch,
    runs: Integers,
    values: Floats,
    outputs: list[int],
    every: int,
    threads: int | None = None,
) -> Floats:
    """Some outputs (runs x N x chosen) of runs with these values: of their states, on CasADi's virtual machine."""
    given, kernel = fleet.binding.lanes(values), _watched(fleet.kernel, every)
    start, shared, supply = fleet.started(given.states), fleet.exogenous, fleet.own.supply(runs)
    found, _ = lanes.run(
        kernel, start, shared, fleet.params, supply, given.params, every=every, threads=threads
    )
    instants, params, step = (
        shared[::every, :-2].copy(),
        fleet.binding.params.copy(),
        fleet.loop.step,
    )
    s, w, p = (ca.SX.sym(name, step.size1_in(i)) for i, name in enumerate("swp"))
    show = interpret.mapped(
        ca.Function("show", [ca.vertcat(s, w), p], [step(s, w, p)[1][outputs]]), len(instants)
    )
    shown = np.empty((len(runs), len(instants), len(outputs)))
    for lane, (states, _, own) in enumerate(
        np.split(trail, [s.numel(), start.shape[1]], axis=1) for trail in found
    ):
        instants[:, fleet.own.entries] = own
        params[list(given.indices)] = given.params[lane]
        shown[lane] = show(np.hstack([states, instants]), params)
    return shown


def _watched(kernel: lanes.Kernel, every: int) -> lanes.Kernel:
    """The kernel called for `every` steps at a time, which records its states and own inputs before each call."""
    shape = kernel.shape
    states, own, width = shape.sizes[0], len(shape.exogenous), shape.width

    def block(
        steps: int, work: Floats, exogenous: Floats, params: Floats, inputs: Floats, outputs: Floats
    ) -> None:
        now, nothing = work.reshape(kernel.rows, -1)[:states, :width], np.empty(0)
        exogenous, inputs, outputs = (
            exogenous.reshape(steps, -1),
            inputs.reshape(steps, own, width),
            outputs.reshape(-1, states + own, width),
        )
        for k in range(0, steps, every):
            outputs[k, :states], outputs[k, states:] = now, inputs[k]
            kernel.block(
                min(every, steps - k),
                work,
                exogenous[k : k + every].ravel(),
                params,
                inputs[k : k + every].ravel(),
                nothing,
            )

    return kernel._replace(block=block, shape=shape._replace(record=tuple(range(states + own))))


def _problem(fleet: Batch, values: Floats, what: str) -> Problem:
    """The problem as one run had it: its sensor and the size of its reference."""
    numbers: Params = tree.rebuild(
        fleet.loop.params, _unpacked(fleet.loop.params, fleet.binding.packed(values)[1])
    )
    sensor = msgspec.structs.replace(
        fleet.problem.sensor,
        **{
            name: getattr(numbers.sensor, name)
            for name in numbers.sensor._fields
            if getattr(numbers.sensor, name).size
        },
        noise=numbers.scale.after,
        noise_before=numbers.scale.before,
    )
    reference = fleet.problem.reference
    scenario = msgspec.structs.replace(
        fleet.problem.scenario, title=f"{fleet.problem.scenario.title}, {what}"
    )
    plant = fleet.problem.plant._replace(params=numbers.plant)
    return fleet.problem._replace(
        scenario=scenario,
        plant=plant,
        sensor=sensor,
        reference=reference._replace(Q=reference.Q * numbers.scale.reference),
    )


def _unpacked(like: Any, numbers: Floats) -> Iterator[Floats]:
    """The parts of packed numbers in the shapes of a tree's leaves."""
    start = 0
    for _, leaf in tree.leaves(like):
        yield numbers[start : start + np.size(leaf)].reshape(np.shape(leaf), order="F")
        start += np.size(leaf)
