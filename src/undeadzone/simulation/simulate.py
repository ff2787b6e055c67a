"""Simulation of a scenario: exogenous signals, a loop in an engine, and one or two `Run`s."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Literal, NamedTuple, get_args

import msgspec
import numpy as np

from undeadzone.compile import interpret
from undeadzone.errors import InputError
from undeadzone.interfaces import require_graph
from undeadzone.results.info import IntegrationError
from undeadzone.results.run import Run
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.simulation import exogenous as inputs
from undeadzone.simulation import sample_by_sample as live
from undeadzone.simulation.close import close
from undeadzone.simulation.collect import collect
from undeadzone.simulation.loop import Loop, Outputs
from undeadzone.util import tree
from undeadzone.util.arrays import Floats
from undeadzone.util.progress import notebook_progress
from undeadzone.util.toml import to_tables

Engine = Literal["auto", "interpret", "lanes"]
Progress = Callable[[int], None]  # called with the number of steps just done
# (state, exogenous inputs, params, progress) -> recorded outputs (rows: time), final state
LoopEngine = Callable[[Floats, Floats, Floats, Progress | None], tuple[Floats, Floats]]


def simulate(
    scenario: Scenario,
    *,
    check_step: bool = True,
    progress: Progress | None = None,
    engine: Engine = "auto",
    controller: live.ControlLaw | None = None,
) -> Run:
    """Simulate a scenario.

    Args:
        scenario: what to simulate.
        check_step: in continuous time, run again with half the step and report the difference as
            `integration_error`.
        progress: called with the number of steps just done, from two threads (None: a bar in a
            notebook).
        engine: CasADi's virtual machine (interpret), or the loop compiled for this CPU (lanes).
            They agree to the last bits. auto: compiled if it was compiled before, or if the run is
            longer than a compilation.
        controller: a function of one's own in the place of the scenario's controller, in sampled
            time: controller(t, estimate, r) is the input u (m) at t [s], with the `Estimate` of
            that sample as NumPy arrays and r the reference of the tracked outputs.

    Returns:
        The signals of the run, and the facts about them.

    Raises:
        InputError: or a subclass, for errors in the scenario.

    Example:
        >>> run = uz.simulate(scenario)
        >>> round(run.summary()["d_right"], 1)
        1.0

    See Also:
        estimate, compare, run_ensemble, plot
    """
    return simulate_scenario(scenario, check_step, progress, engine, controller).run


class Simulated(NamedTuple):
    """Run with its problem and start.

    Attributes:
        run: the run.
        problem: the scenario's parts.
        start: start of the run (None: an observer or a controller computes in Python).
    """

    run: Run
    problem: Problem
    start: Start | None


def simulate_scenario(
    scenario: Scenario,
    check_step: bool = True,
    progress: Progress | None = None,
    engine: Engine = "auto",
    controller: live.ControlLaw | None = None,
) -> Simulated:
    """Simulate a scenario with the arguments of `simulate`, and return the run and its problem."""
    began = time.perf_counter()
    problem = resolve_scenario(scenario)
    with notebook_progress(
        progress, "simulating", count_progress_steps(scenario, check_step)
    ) as advance:
        if controller is not None:
            problem = _under(controller, problem, engine)
        # As lanes an observer in Python is refused when the loop is closed.
        in_python = problem.observer.python is not None and engine != "lanes"
        start = None if in_python or controller is not None else prepare(problem)
        signal, error = signals_of(problem, start, advance, check_step, engine, controller)
    run = collect(problem, signal, error, began)
    if controller is not None:  # the function has no text
        run = _with_info(run, scenario="")
    return Simulated(run, problem, start)


def count_progress_steps(scenario: Scenario, check_step: bool = True) -> int:
    """Return the number of steps that `simulate` reports to its progress callback."""
    times = 3 if check_step and scenario.simulation.time == "continuous" else 1
    return round(times * scenario.simulation.duration / max(scenario.simulation.step, 1e-12))


def _under(law: live.ControlLaw, problem: Problem, engine: Engine) -> Problem:
    """Return the problem with a control law in Python for its controller. Raises InputError."""
    if not callable(law):
        raise InputError(
            f"controller: expected a function of t, estimate and r, found {type(law).__name__}. "
            "A controller with options stands in the scenario"
        )
    if problem.plant.Ts is None:
        raise InputError(
            'controller: a function runs sample by sample. Set simulation.time = "sampled"'
        )
    if engine == "lanes":
        raise InputError("engine: a controller that is a Python function cannot be compiled")
    return problem._replace(controller=live.placeholder_controller(problem.plant.m))


def signals_of(
    problem: Problem,
    start: Start | None,
    progress: Progress | None,
    check_step: bool = False,
    engine: Engine = "auto",
    law: live.ControlLaw | None = None,
) -> tuple[Outputs, IntegrationError | None]:
    """Return the signals of a run, and the error of its integration where that is measured.

    Args:
        problem: the scenario's parts.
        start: start of the run (None: an observer or a law computes in Python).
        progress: called with the number of steps just done.
        check_step: as for `simulate`.
        engine: as for `simulate`.
        law: in place of a controller (None: there is none).
    """
    if start is None:
        exogenous = inputs.exogenous(problem)
        return live.run_sample_by_sample(problem, exogenous, progress, law), None
    twin = check_step and problem.plant.Ts is None
    run = engine_for(start.loop, engine, len(start.exogenous) * (3 if twin else 1))
    if twin:
        return _with_error(problem, start, progress, run)
    return outputs_of(start, progress, run), None


def _with_error(
    problem: Problem, start: Start, progress: Progress | None, run: LoopEngine
) -> tuple[Outputs, IntegrationError]:
    """Return the signals of a run, and by how much its twin of half the step differs, run beside
    it.
    """
    interrupted = threading.Event()

    def tick(done: int) -> None:
        if interrupted.is_set():
            raise InterruptedError
        if progress is not None:
            progress(done)

    with ThreadPoolExecutor(1) as beside:
        twin = beside.submit(_at_half_the_step, problem, start, tick, run)
        try:
            signal = outputs_of(start, progress, run)
            return signal, _difference(signal, twin.result())
        except BaseException:
            interrupted.set()
            raise


def outputs_of(
    start: Start, progress: Progress | None = None, run: LoopEngine | None = None
) -> Outputs:
    """Run a loop from its initial state and return its outputs by name.

    Args:
        start: loop, initial state and exogenous inputs.
        progress: called with the number of steps just done.
        run: engine of the loop, from `engine_for`. Loops of the same graph share one. None: a new
            one.
    """
    if run is None:
        run = engine_for(start.loop, "auto", len(start.exogenous))
    packed, _ = run(start.state, start.exogenous, tree.pack_tree(start.loop.params), progress)
    return name_outputs(start.loop, packed)


def _at_half_the_step(
    problem: Problem, start: Start, progress: Progress, run: LoopEngine
) -> Outputs:
    """Return the signals of a run with half the step, at the instants of the whole ones."""
    params = start.loop.params
    halved = start.loop._replace(params=params._replace(h=params.h / 2))
    fine = outputs_of(Start(halved, start.state, inputs.exogenous(problem, 2)), progress, run)
    outputs: Outputs = tree.map_leaves(lambda part: part[::2], fine)
    return outputs


class Start(NamedTuple):
    """Start of a run.

    Attributes:
        loop: the closed loop.
        state: its packed initial state, with the plant at x0.
        exogenous: the exogenous inputs (steps + 1 rows).
    """

    loop: Loop
    state: Floats
    exogenous: Floats


def prepare(problem: Problem) -> Start:
    """Return the start of a run of a problem."""
    loop = close_problem(problem)
    state = tree.pack_tree(loop.state._replace(plant=problem.x0))
    return Start(loop, state, inputs.exogenous(problem))


def close_problem(problem: Problem) -> Loop:
    """Return the closed loop of a problem. Raises InputError if the observer is not a graph."""
    return close(problem._replace(observer=require_graph(problem.observer)))


def engine_for(loop: Loop, engine: Engine, steps: int) -> LoopEngine:
    """Return the engine of a loop: run(state, exogenous, params, progress) gives outputs and end.

    Args:
        loop: the closed loop.
        engine: auto, interpret or lanes.
        steps: that it is going to run.

    Raises:
        InputError: the engine is unknown.
    """
    if engine not in get_args(Engine):
        raise InputError(f"engine: expected auto, interpret or lanes, found {engine!r}")
    if engine != "interpret":
        from undeadzone.compile import lanes

        parts = (loop.step, ()) if loop.parts is None else loop.parts
        wait = engine == "lanes" or steps > interpret.WORTH
        compiled = (
            lanes.build_kernel(*parts, width=1, fast_start=False)
            if wait
            else lanes.read_cached_kernel(*parts)
        )
        if compiled is not None:
            return partial(lanes.run_single_lane, compiled)
    return partial(interpret.run_interpreted, loop.step)


def name_outputs(loop: Loop, outputs: Floats) -> Outputs:
    """Return the columns of recorded outputs (N x all) by name."""
    by_name: Outputs = tree.unpack_columns(loop.outputs, outputs)
    return by_name


def _difference(coarse: Outputs, fine: Outputs) -> IntegrationError:
    """Return the differences between a run and its twin of half the step."""
    of_x = np.abs(coarse.x - fine.x).max()
    of_z = np.abs(coarse.z - fine.z).max()
    gaps = {}
    for name in ("x", "z", "right", "left"):
        one = getattr(coarse.estimate, name)
        other = getattr(fine.estimate, name)
        gaps[name] = np.abs(one - other).max()
    largest = [of_x, gaps["x"], gaps["right"], gaps["left"]]
    outputs = [of_z, gaps["z"], gaps["right"], gaps["left"]]
    if not np.isfinite([*largest, *outputs]).all():
        return IntegrationError(float("inf"), float("inf"))
    size = max(float(np.abs(coarse.z).max()), 1e-300)
    return IntegrationError(float(max(largest)), float(max(outputs)) / size)


def compare(
    scenario: Scenario, *, progress: Callable[[int], None] | None = None
) -> tuple[Run, Run]:
    """Simulate a scenario, and the same scenario with the observer of its [compare] table.

    Args:
        scenario: scenario to simulate. Its `compare` names the other observer.
        progress: called with the number of steps just done, of both runs (None: a bar in a
            notebook).

    Returns:
        The run of the scenario's own observer and that of the other. Each `info.label` names the
        difference of the two observers.

    Raises:
        InputError: the scenario has no [compare], or, also as a subclass, an error of `simulate`.

    Example:
        >>> other = uz.Kalman(right=[0.0, 2.0], disturbance=0.2)
        >>> run, rival = uz.compare(msgspec.structs.replace(scenario, compare=other))
        >>> rival.info.method
        'kalman'

    See Also:
        simulate, plot
    """
    if scenario.compare is None:
        raise InputError(
            "compare: this scenario has no [compare]. Name there the observer whose run is to be "
            'shown beside the first, such as method = "luenberger"'
        )
    with notebook_progress(progress, "simulating", 2 * count_progress_steps(scenario)) as advance:
        return beside(scenario, simulate(scenario, progress=advance), advance)


def beside(
    scenario: Scenario, run: Run, progress: Callable[[int], None] | None = None
) -> tuple[Run, Run]:
    """Return the run of a scenario and that of the observer of its [compare] table, both labelled.

    Args:
        scenario: which has a [compare] table.
        run: of it.
        progress: called with the number of steps just done.
    """
    rival = msgspec.structs.replace(scenario, observer=scenario.compare)
    second = simulate(rival, progress=progress)
    one, other = labels(scenario.observer, scenario.compare)
    return _with_info(run, label=one), _with_info(second, label=other)


def labels(first: Any, second: Any) -> tuple[str, str]:
    """Return names that distinguish two observers.

    These are their methods, and, if the methods are the same, one option that differs, a switch if
    possible.
    """
    one = to_tables(first)
    other = to_tables(second)
    differing = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    if "method" in differing or not differing:
        return _in_words(one, "method"), _in_words(other, "method")
    switches = [name for name in differing if True in (one.get(name), other.get(name))]
    name = (switches or differing)[0]
    return _in_words(one, name), _in_words(other, name)


def _in_words(options: dict[str, Any], name: str) -> str:
    """Return a method, and one of its options, in words."""
    method = str(options["method"])
    value = options.get(name)
    if name == "method" or value in (None, False, {}):
        return method
    if value is True:
        return f"{method}, {name}"
    if isinstance(value, dict):
        return f"{method}, {name} {', '.join(value)}"
    return f"{method}, {name} = {value}"


def _with_info(run: Run, **info: Any) -> Run:
    """Return the run with other words in its info."""
    return dataclasses.replace(run, info=msgspec.structs.replace(run.info, **info))
