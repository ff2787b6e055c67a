"""The closed loop around an observer or a control law in Python, stepped one sample at a time.

Plant and sensor stay on the graph, as well as all other parts that are graphs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from undeadzone.compile.interpret import CHUNK, Stepper
from undeadzone.errors import InputError
from undeadzone.feedforward.targets import Target
from undeadzone.interfaces import Controller, Estimate, PythonObserver, Reading
from undeadzone.nonlinearities.limits import is_beyond_range
from undeadzone.nonlinearities.sensor import Zone, side
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.close import close
from undeadzone.simulation.loop import Outputs
from undeadzone.util import tree
from undeadzone.util.arrays import Floats, require_vector

ControlLaw: TypeAlias = Callable[[float, Estimate, Floats], Any]


def run_sample_by_sample(
    problem: Problem,
    exogenous: Floats,
    progress: Callable[[int], None] | None = None,
    law: ControlLaw | None = None,
) -> Outputs:
    """Return the outputs of the closed loop along exogenous inputs, by name (rows: time).

    Args:
        problem: the problem to simulate, in sampled time.
        exogenous: exogenous inputs (steps + 1 rows).
        progress: called with the number of steps just done.
        law: law(t, estimate, r) is the input (m) at t [s]. The problem's controller is then
            `placeholder_controller`. None: the problem's controller is a graph.

    Raises:
        InputError: the law gives no finite input of m entries.
    """
    numeric = problem.observer.python
    loop = close(problem)
    initial = tree.pack_tree(loop.state._replace(plant=problem.x0))
    stepper = Stepper(loop.step, initial, tree.pack_tree(loop.params))
    where: Outputs = tree.leaf_slices(loop.outputs)
    r = tree.leaf_slices(loop.instant).target.r
    levels = problem.levels
    n = problem.plant.n
    m = problem.plant.m
    estimated = slice(n, n + tree.count_numbers(loop.state.observer))
    driving = slice(estimated.stop, estimated.stop + tree.count_numbers(loop.state.controller))
    outputs = np.empty((exogenous.shape[0], tree.count_numbers(loop.outputs)))
    state = None if numeric is None else numeric.start(problem.scenario.simulation.seed)
    for k, row in enumerate(exogenous):
        stepper.w[:] = row
        before = stepper.state.copy()
        stepper()  # for its reading and estimate, which do not depend on the input
        estimate = Estimate(*(stepper.out[part].copy() for part in where.estimate))
        if numeric is not None:
            reading = Reading(stepper.out[where.y].copy(), stepper.out[where.side].copy())
            state, estimate = numeric.correct(state, reading)
            before[estimated] = tree.pack_tree(tuple(estimate))
        if law is not None:
            t = k * problem.scenario.simulation.step
            law_estimate = estimate
            reference = row[r].copy()
            if levels is not None:
                law_estimate = levels.restore_estimate(estimate)
                reference += levels.r
            before[driving] = _input(law(t, law_estimate, reference), m, t)
            if levels is not None:
                before[driving] -= levels.u
        stepper.state[:] = before
        stepper()
        outputs[k] = stepper.out
        if numeric is not None:
            state = numeric.predict(state, outputs[k, where.u])
        last = k + 1 == exogenous.shape[0]
        if progress is not None and (last or (k + 1) % CHUNK == 0):
            progress(k % CHUNK + 1)
    by_name: Outputs = tree.unpack_columns(loop.outputs, outputs)
    return by_name


def placeholder_controller(m: int) -> Controller:
    """Return the controller that replaces a control law in Python on the graph.

    Its state is the input, written from outside before each step.

    Args:
        m: number of inputs.
    """

    def step(params: Any, state: Any, estimate: Estimate, target: Target) -> tuple[Any, Any]:
        return state, state

    return Controller((), lambda params: np.zeros(m), step)


def _input(u: Any, m: int, t: float) -> Floats:
    """Return the input (m) of a law, checked. Raises InputError."""
    try:
        return require_vector("controller", u, m, "one per input")
    except InputError as error:
        raise type(error)(f"{error}, from the control law at t = {t:g} s") from None


def numeric_along(
    observer: PythonObserver,
    sensor: Zone,
    y: Floats,
    u: Floats,
    seed: int,
    progress: Callable[[int], None] | None = None,
) -> tuple[Estimate, Floats]:
    """Return the estimates of an observer that computes in Python.

    Args:
        observer: the observer.
        sensor: the dead zone, for its threshold and its range.
        y: readings (N x p), NaN if one is missing.
        u: inputs (N x m), NaN if the last one is held.
        seed: of its random numbers.
        progress: called with the number of steps just done.

    Returns:
        The estimates, a row for each sample in each field, and the measured sides (N x p).
    """
    state = observer.start(seed)
    last_input = np.zeros(u.shape[1])
    if sensor.limits is not None:
        y = np.where(is_beyond_range(y, sensor.limits), np.nan, y)
    sides = side(y, sensor.threshold, sensor.limits)
    rows = []
    for k in range(len(y)):
        last_input = np.where(np.isfinite(u[k]), u[k], last_input)
        state, estimate = observer.correct(state, Reading(y[k].copy(), sides[k].copy()))
        rows.append(estimate)
        state = observer.predict(state, last_input)
        if progress is not None and (k + 1) % CHUNK == 0:
            progress(CHUNK)
    return Estimate(*map(np.stack, zip(*rows, strict=True))), sides
