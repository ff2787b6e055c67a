"""The closed loop around an observer that computes in Python, stepped one sample at a time.

Plant, sensor and controller stay on the graph.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from undeadzone.engine.interpret import CHUNK, Stepper
from undeadzone.interfaces import Estimate, NumericObserver, Observer, Reading
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.close import close
from undeadzone.simulation.loop import Loop, Outputs
from undeadzone.support import tree
from undeadzone.support.arrays import Floats


def run_sample_by_sample(
    problem: Problem,
    observer: NumericObserver,
    exogenous: Floats,
    progress: Callable[[int], None] | None = None,
) -> Outputs:
    """The outputs of the closed loop along exogenous inputs, by name (rows: time).

    Args:
        problem: what is simulated.
        observer: the observer that computes in Python.
        exogenous: exogenous inputs (steps + 1 rows).
        progress: called with the number of steps just done.
    """
    simulation = problem.scenario.simulation
    loop = _loop_around(problem, observer)
    initial = tree.pack(loop.state._replace(plant=problem.x0))
    stepper = Stepper(loop.step, initial, tree.pack(loop.params))
    where: Outputs = tree.slices(loop.outputs)
    estimated = slice(problem.plant.n, problem.plant.n + tree.size(loop.state.observer))
    outputs = np.empty((exogenous.shape[0], tree.size(loop.outputs)))
    state = observer.start(simulation.seed)
    for k, row in enumerate(exogenous):
        stepper.w[:] = row
        before = stepper.state.copy()
        stepper()  # for its reading alone, which does not depend on the estimate
        reading = Reading(stepper.out[where.y].copy(), stepper.out[where.side].copy())
        state, estimate = observer.correct(state, reading)
        before[estimated] = tree.pack(tuple(estimate))
        stepper.state[:] = before
        stepper()
        outputs[k] = stepper.out
        state = observer.predict(state, outputs[k, where.u])
        last = k + 1 == exogenous.shape[0]
        if progress is not None and (last or (k + 1) % CHUNK == 0):
            progress(k % CHUNK + 1)
    by_name: Outputs = tree.rebuild(where, (outputs[:, part] for _, part in tree.leaves(where)))
    return by_name


def _loop_around(problem: Problem, observer: NumericObserver) -> Loop:
    """The loop of a problem with the observer's estimate left to be written in."""
    stand_in = relay(observer, problem.plant.p)
    outputs_tracked = len(problem.tracked)
    step = problem.scenario.simulation.step
    return close(problem.plant, problem.sensor, stand_in, problem.controller, outputs_tracked, step)


def relay(observer: NumericObserver, p: int) -> Observer:
    """What stands for the observer on the graph.

    Its state is the estimate, written from outside before each step.

    Args:
        observer: the observer that computes in Python.
        p: number of outputs.
    """
    missing = Reading(np.full(p, np.nan), np.zeros(p))
    _, first = observer.correct(observer.start(0), missing)

    def step(params: Any, state: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
        return state, Estimate(*state)

    return Observer((), lambda params: tuple(first), step, traits=observer.traits)
