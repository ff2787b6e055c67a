"""Run a scenario: exogenous signals in, the loop through an engine, a `Run` out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np

from undeadzone import noise, signals, tree
from undeadzone.arrays import Floats, vector
from undeadzone.design.identifiability import unknown_bias, verdicts
from undeadzone.design.passivity import Certificate, certify
from undeadzone.design.schedule import recorded
from undeadzone.engine import interpret
from undeadzone.errors import InputError
from undeadzone.feedforward import Target, inverted_targets, linear_targets
from undeadzone.loop import Loop, Outputs, close
from undeadzone.problem import Problem, constant_gains, resolve_scenario
from undeadzone.run import Info, Run
from undeadzone.scenario import Scenario

Engine = Literal["interpret", "lanes"]

NUDGE = 1e-9  # of a step: corners of a reference on the grid belong to the step that follows them


def simulate(scenario: Scenario, *, check_step: bool = True, progress: Callable[[int], None] | None = None, engine: Engine = "interpret") -> Run:
    """Simulate a scenario.

    check_step: in continuous time, run again with half the step and report the difference as `integration_error`.
    progress: called with the number of steps just done, from two threads. engine: CasADi's virtual machine (interpret), or the loop
    compiled for this CPU (lanes), which takes seconds the first time; they agree to the last bits. Raises InputError
    and its kinds for what is wrong.
    """
    began = time.perf_counter()
    problem = resolve_scenario(scenario)
    loop, state, exogenous = prepare(problem)
    if not check_step or problem.plant.Ts is not None:
        return _result(problem, run_loop(loop, state, exogenous, progress, engine), None, began)
    interrupted = threading.Event()

    def tick(done: int) -> None:
        if interrupted.is_set():
            raise InterruptedError
        if progress is not None:
            progress(done)

    def finer() -> Outputs:
        halved = loop._replace(params=loop.params._replace(h=loop.params.h / 2))
        return Outputs(*(part[::2] for part in run_loop(halved, state, _exogenous(problem, 2), tick, engine)))

    with ThreadPoolExecutor(1) as beside:
        twin = beside.submit(finer)
        try:
            signal = run_loop(loop, state, exogenous, progress, engine)
            error = _difference(signal, twin.result())
        except BaseException:
            interrupted.set()
            raise
    return _result(problem, signal, error, began)


def prepare(problem: Problem) -> tuple[Loop, Floats, Floats]:
    """(the closed loop, its initial state with the plant at x0, exogenous inputs (steps + 1 rows))."""
    loop = close(problem.plant, problem.sensor, problem.observer, problem.controller, len(problem.tracked), problem.scenario.simulation.step)
    return loop, tree.pack(loop.state._replace(plant=problem.x0)), _exogenous(problem, 1)


def run_loop(loop: Loop, state: Floats, exogenous: Floats, progress: Callable[[int], None] | None = None, engine: Engine = "interpret") -> Outputs:
    """The outputs of a loop from a packed state along exogenous inputs, by name (rows: time). Raises InputError for an unknown engine."""
    params = tree.pack(loop.params)
    if engine == "lanes":
        from undeadzone.engine import lanes

        outputs = lanes.run(lanes.build(loop.step, width=1), state, exogenous, params, progress=progress)[0][0]
    elif engine == "interpret":
        outputs, _ = interpret.run(loop.step, state, exogenous, params, progress)
    else:
        raise InputError(f"engine: expected interpret or lanes, found {engine!r}")
    widths = [part.size for part in loop.outputs]
    return Outputs(*np.split(outputs, np.cumsum(widths)[:-1], axis=1))


def _exogenous(problem: Problem, refine: int) -> Floats:
    """One row per step (and one for the last instant): target, disturbance, noise; three instants if continuous."""
    simulation, plant = problem.scenario.simulation, problem.plant
    step = simulation.step / refine
    starts = np.arange(problem.steps * refine + 1) * step
    held = np.arange(starts.size) // refine
    samples = problem.steps + 1
    after = (noise.gaussian(simulation.seed, noise.AFTER, samples, plant.p) * problem.sensor.noise)[held]
    before = (noise.gaussian(simulation.seed, noise.BEFORE, samples, plant.p) * problem.sensor.noise_before)[held]
    if plant.Ts is not None:
        return np.hstack([*_targets(problem, starts), disturbance(problem, starts + step / 2), before, after])
    instants = (starts + NUDGE * step, starts + step / 2, starts + (1 - NUDGE) * step)
    return np.hstack([part for t in instants for part in (*_targets(problem, t), disturbance(problem, t), before, after)])


def _targets(problem: Problem, t: Floats) -> Target:
    if not problem.model.nonlinear:
        return linear_targets(problem.model, problem.reference, problem.tracked, t)
    eq = problem.scenario.plant.x_eq
    start = np.zeros(problem.model.n) if eq is None else vector("plant.x_eq", eq, problem.model.n)
    target = inverted_targets(problem.flow, problem.reference, problem.tracked, t, start)
    if problem.model.Ts is not None:
        held = inverted_targets(problem.flow, problem.reference, problem.tracked, t + problem.model.Ts / 2, start)
        target = target._replace(u_ff=held.u_ff)
    return target


def disturbance(problem: Problem, t: Floats) -> Floats:
    """The input disturbance (len(t) x m); random ones are straight lines between samples of the time grid."""
    signal, m = problem.scenario.disturbance, problem.plant.m
    if isinstance(signal, signals.Random):
        step = problem.scenario.simulation.step
        rms = np.broadcast_to(np.asarray(signal.rms, float).ravel(), m)
        knots = noise.coloured(problem.scenario.simulation.seed, problem.steps + 3, rms, signal.correlation_time, step)
        grid = np.arange(problem.steps + 3) * step
        return np.stack([np.interp(t, grid, column) for column in knots.T], axis=1)
    return np.zeros((t.size, m)) if problem.disturbance is None else problem.disturbance.value(t)


def _difference(coarse: Outputs, fine: Outputs) -> float:
    """The largest difference of x, x^, d^ between a run and its twin of half the step."""
    gaps = [np.abs(getattr(coarse, name) - getattr(fine, name)).max() for name in ("x", "x_hat", "right", "left")]
    return float(max(gaps)) if np.isfinite(gaps).all() else float("inf")


def certificate(problem: Problem) -> Certificate | None:
    """The proof that V never rises, for observers with constant gains L, gamma on a linear model; else None."""
    gains = constant_gains(problem.observer, problem.model)
    return None if gains is None or problem.model.nonlinear else certify(problem.model.linear, *gains, problem.model.Ts)


def _result(problem: Problem, signal: Outputs, error: float | None, began: float) -> Run:
    scenario = problem.scenario
    t = np.arange(problem.steps + 1) * scenario.simulation.step
    d_hat, d_std = (np.stack(pair, axis=2).reshape(t.size, -1) for pair in ((signal.right, signal.left), (signal.right_std, signal.left_std)))
    stds = {"x_std": signal.x_std, "d_std": d_std, "width_std": signal.width_std, "innovation_std": signal.innovation_std}
    truth = np.stack([problem.sensor.right, problem.sensor.left], axis=1).ravel()
    proof = certificate(problem)
    V = None
    if proof is not None and proof.certified:
        # A width that is wrong and not adapted disturbs for ever: no V. A jump sensor's widths do not enter.
        d_error = truth - d_hat if problem.sensor.kind == "deadzone" else np.zeros_like(d_hat)
        adapted = np.repeat(problem.observer.params.gamma > 0, 2)
        V = proof.V.value(signal.x - signal.x_hat, d_error) if (adapted | (d_error == 0)).all() else None
    schedule = recorded(signal.z, problem.sensor, scenario.simulation.step, problem.model.Ts)
    found = verdicts(problem.model.linear, schedule, unknown_bias(scenario.disturbance, problem.model.linear.B), problem.sensor.kind == "jump")
    return Run(
        t=t, x=signal.x, z=signal.z, y=signal.y, side=signal.side, x_hat=signal.x_hat, z_hat=signal.z_hat, d_hat=d_hat,
        z_inverse=signal.z_inverse, innovation=signal.innovation, u=signal.u,
        r=problem.reference.value(t), V=V,
        info=Info(
            title=scenario.title,
            method=str(type(scenario.observer).__struct_config__.tag),
            time=scenario.simulation.time,
            step=scenario.simulation.step,
            tracked=problem.tracked,
            widths=truth.tolist(),
            threshold=problem.sensor.threshold.tolist(),
            certified=None if proof is None else proof.certified,
            integration_error=error,
            identifiable=[verdict._asdict() | {"reasons": list(verdict.reasons)} for verdict in found],
            seconds=time.perf_counter() - began,
            units=scenario.units,
        ),
        **{name: value for name, value in stds.items() if value.size},
    )  # fmt: skip
