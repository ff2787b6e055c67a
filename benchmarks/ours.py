"""Our side of the benchmarks: the loop's graph on the lanes engine, with the same result as every rival."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import msgspec
import numpy as np

from benchmarks.workload import Result, Work, draw
from undeadzone.engine import lanes
from undeadzone.ensemble.batch import known_inputs, known_params
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.simulate import closed
from undeadzone.simulation.simulate import prepare as prepare_run
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

WIDTHS = ("sensor.right[0]", "sensor.left[0]")
UNITS = (
    "sensor.slope",
    "sensor.threshold",
    "observer.slope",
    "observer.threshold",
    "scale",
)  # 1 or 0: rivals have no such numbers
FINER = 16


def prepare(
    work: Work,
    *,
    step: str = "located",
    order: int = 4,
    width: int = lanes.WIDTH,
    known: bool = False,
    threads: int = 1,
    every: int = 1,
) -> Callable[[], Result]:
    """known: zeros and ones of plant and observer are known when compiled, as in ensembles; else they are read at run time.

    order: 4 for RK4, more for Taylor series; every: take the rms from each so many-th step.
    """
    kernel, exogenous, params = _kernel(_with(work, step, order), width, known, every)
    states = np.hstack([work.states, np.zeros((len(work.states), 1))])
    count = exogenous[:, -1].sum()

    def run() -> Result:
        _, finals = lanes.run(kernel, states, exogenous, params, None, work.widths, threads=threads)
        return Result(finals[:, :-1], np.sqrt(finals[:, -1] / count))

    return run


def instructions(work: Work, step: str) -> int:
    """Instructions of the step that every run takes."""
    return _summed(closed(_with(work, step, 4).problem))[0].n_instructions()


def truth(work: Work) -> Result:
    """The result with a step so much shorter that its error does not matter (sampled: the same step)."""
    problem = work.problem
    if problem.plant.Ts is not None:
        return prepare(work)()
    runs, n, duration = len(work.states), len(work.B), problem.scenario.simulation.duration
    return prepare(draw(runs, duration, n=n, step=work.step / FINER), every=FINER)()


def _kernel(work: Work, width: int, known: bool, every: int) -> tuple[lanes.Kernel, Floats, Floats]:
    """(kernel, exogenous inputs with 1 where the rms is taken, params)."""
    loop, _, shared = prepare_run(work.problem)
    shared = shared[: len(work.targets)]
    places = np.arange(len(shared))
    exogenous = np.column_stack(
        [shared, (places >= len(shared) - work.tail) & (places % every == 0)]
    )
    params, names = tree.pack(loop.params), tree.names(loop.params)
    indices = tuple(names.index(name) for name in WIDTHS)
    given = {
        i: value
        for i, value in known_params(params, indices).items()
        if known or names[i].startswith(UNITS)
    }
    usual, rare = _summed(loop)
    kernel = lanes.build(
        usual,
        rare,
        params=indices,
        record=[],
        known_exogenous=known_inputs(shared, ()),
        known_params=given,
        width=width,
        fused=True,
    )
    return kernel, exogenous, params


def _with(work: Work, step: str, order: int) -> Work:
    """The work by another integrator."""
    scenario = work.problem.scenario
    simulation = msgspec.structs.replace(
        scenario.simulation, switching="plain" if step == "plain" else "located", order=order
    )
    return work._replace(
        problem=work.problem._replace(
            scenario=msgspec.structs.replace(scenario, simulation=simulation)
        )
    )


def _summed(loop: Loop) -> tuple[ca.Function, tuple[ca.Function, ...]]:
    """The loop's step and its rare part, with a last state that sums (z - r)^2 where a last exogenous input is 1."""
    step, rare = (loop.step, ()) if loop.parts is None else loop.parts
    s, w, p = (
        ca.SX.sym(name, step.size1_in(i) + more)
        for i, (name, more) in enumerate((("s", 1), ("w", 1), ("p", 0)))
    )
    given = (s[:-1], w[:-1], p)
    following, out, *flag = step(*given)
    error = tree.unpack(loop.outputs, out).z - tree.unpack(loop.instant, w).target.r
    usual = ca.Function(
        "summed", [s, w, p], [ca.vertcat(following, s[-1] + w[-1] * error**2), out, *flag]
    )
    return usual, tuple(ca.Function("rare", [s, w, p], part(*given)) for part in rare)
