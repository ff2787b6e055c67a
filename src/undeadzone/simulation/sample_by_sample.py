"""The closed loop around an observer that computes in Python: plant, sensor and controller stay on the graph, stepped one sample at a time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from undeadzone.engine.interpret import CHUNK, Stepper
from undeadzone.interfaces import Estimate, NumericObserver, Observer, Reading
from undeadzone.scenario.problem import Problem
from undeadzone.simulation.loop import Outputs, close
from undeadzone.support import tree
from undeadzone.support.arrays import Floats


def run_sample_by_sample(
    problem: Problem,
    observer: NumericObserver,
    exogenous: Floats,
    progress: Callable[[int], None] | None = None,
) -> Outputs:
    """The outputs of the closed loop along exogenous inputs (steps + 1 rows), by name (rows: time); progress is told of steps done."""
    simulation = problem.scenario.simulation
    loop = close(
        problem.plant,
        problem.sensor,
        relay(observer, problem.plant.p),
        problem.controller,
        len(problem.tracked),
        simulation.step,
    )
    stepper = Stepper(
        loop.step, tree.pack(loop.state._replace(plant=problem.x0)), tree.pack(loop.params)
    )
    where: Outputs = tree.slices(loop.outputs)
    estimated = slice(problem.plant.n, problem.plant.n + tree.size(loop.state.observer))
    outputs = np.empty((exogenous.shape[0], tree.size(loop.outputs)))
    state = observer.start(simulation.seed)
    for k, row in enumerate(exogenous):
        stepper.w[:] = row
        before = stepper.state.copy()
        stepper()  # for its reading alone, which does not depend on the estimate
        state, estimate = observer.correct(
            state, Reading(stepper.out[where.y].copy(), stepper.out[where.side].copy())
        )
        before[estimated] = tree.pack(tuple(estimate))
        stepper.state[:] = before
        stepper()
        outputs[k] = stepper.out
        state = observer.predict(state, outputs[k, where.u])
        if progress is not None and ((k + 1) % CHUNK == 0 or k + 1 == exogenous.shape[0]):
            progress(k % CHUNK + 1)
    by_name: Outputs = tree.rebuild(where, (outputs[:, part] for _, part in tree.leaves(where)))
    return by_name


def relay(observer: NumericObserver, p: int) -> Observer:
    """What stands for the observer on the graph: its state is the estimate, written from outside before each step."""
    _, first = observer.correct(observer.start(0), Reading(np.full(p, np.nan), np.zeros(p)))

    def step(params: Any, state: Any, u: Any, reading: Reading) -> tuple[Any, Estimate]:
        return state, Estimate(*state)

    return Observer((), lambda params: tuple(first), step, traits=observer.traits)
