"""Our side of the benchmarks: the loop's graph on the lanes engine, with every rival's result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from benchmarks.engine.work.paper_loop import Result, Work, draw
from undeadzone.compile import lanes
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.simulate import close_problem
from undeadzone.simulation.simulate import prepare as prepare_run
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.batch import constant_params, constant_zero_inputs

WIDTHS = ("sensor.right[0]", "sensor.left[0]")
# 1 or 0: rivals have no such numbers
UNITS = ("sensor.slope", "sensor.threshold", "observer.slope", "observer.threshold", "scale")
FINER = 16


class Program(NamedTuple):
    """What a run of the lanes engine is given.

    Attributes:
        kernel: compiled
        states: at the beginning
        exogenous: w of each step
        params: p
    """

    kernel: lanes.Kernel
    states: Floats
    exogenous: Floats
    params: Floats


def build_program(
    work: Work,
    *,
    step: str = "located",
    order: int = 4,
    width: int | None = None,
    known: bool = False,
    every: int = 1,
) -> Program:
    """The work compiled: `prepare` has the options."""
    kernel, exogenous, params = _kernel(_with(work, step, order), width, known, every)
    states = np.hstack([work.states, np.zeros((len(work.states), 1))])
    return Program(kernel, states, exogenous, params)


def prepare(work: Work, *, threads: int = 1, **options: Any) -> Callable[[], Result]:
    """The work made ready on the lanes engine.

    Args:
        work: what is done
        threads: on which it runs
        options: step: located, plain or sampled; order: 4 for RK4, more for Taylor series; width:
            lanes of a block; known: zeros and ones of plant and observer are known when compiled,
            as in ensembles, else they are read at run time; every: the rms is taken from each so
            many-th step
    """
    kernel, states, exogenous, params = build_program(work, **options)
    count = exogenous[:, -1].sum()

    def run() -> Result:
        _, finals = lanes.run_lanes(
            kernel, states, exogenous, params, None, work.widths, threads=threads
        )
        return Result(finals[:, :-1], np.sqrt(finals[:, -1] / count))

    return run


def instructions(work: Work, step: str) -> int:
    """Instructions of the step that every run takes."""
    return _summed(close_problem(_with(work, step, 4).problem))[0].n_instructions()


def truth(work: Work) -> Result:
    """The result with a step so short that its error does not matter (sampled: the same step)."""
    problem = work.problem
    if problem.plant.Ts is not None:
        return prepare(work)()
    runs, n, duration = len(work.states), len(work.B), problem.scenario.simulation.duration
    return prepare(draw(runs, duration, n=n, step=work.step / FINER), every=FINER)()


def _kernel(
    work: Work, width: int | None, known: bool, every: int
) -> tuple[lanes.Kernel, Floats, Floats]:
    """(kernel, exogenous inputs with 1 where the rms is taken, params)."""
    loop, _, shared = prepare_run(work.problem)
    shared = shared[: len(work.targets)]
    places = np.arange(len(shared))
    counted = (places >= len(shared) - work.tail) & (places % every == 0)
    exogenous = np.column_stack([shared, counted])
    params, names = tree.pack_tree(loop.params), tree.number_addresses(loop.params)
    indices = tuple(names.index(name) for name in WIDTHS)
    constants = constant_params(params, indices)
    if not known:
        units = [i for i in constants if names[i].startswith(UNITS)]
        constants = {i: constants[i] for i in units}
    usual, rare = _summed(loop)
    kernel = lanes.build_kernel(
        usual,
        rare,
        params=indices,
        record=[],
        known_exogenous=constant_zero_inputs(shared, ()),
        known_params=constants,
        width=width,
        fused=True,
    )
    return kernel, exogenous, params


def _with(work: Work, step: str, order: int) -> Work:
    """The work by another integrator."""
    scenario = work.problem.scenario
    switching = "plain" if step == "plain" else "located"
    simulation = msgspec.structs.replace(scenario.simulation, switching=switching, order=order)
    changed = msgspec.structs.replace(scenario, simulation=simulation)
    return work._replace(problem=work.problem._replace(scenario=changed))


def _summed(loop: Loop) -> tuple[ca.Function, tuple[ca.Function, ...]]:
    """The loop's step and its rare part, with a last state that sums (z - r)^2.

    It does so where a last exogenous input is 1.
    """
    step, rare = (loop.step, ()) if loop.parts is None else loop.parts
    s = ca.SX.sym("s", step.size1_in(0) + 1)
    w = ca.SX.sym("w", step.size1_in(1) + 1)
    p = ca.SX.sym("p", step.size1_in(2))
    own = (s[:-1], w[:-1], p)  # what the loop itself takes
    following, out, *flag = step(*own)
    error = tree.unpack_column(loop.outputs, out).z - tree.unpack_column(loop.instant, w).target.r
    total = s[-1] + w[-1] * error**2
    usual = ca.Function("summed", [s, w, p], [ca.vertcat(following, total), out, *flag])
    return usual, tuple(ca.Function("rare", [s, w, p], part(*own)) for part in rare)
