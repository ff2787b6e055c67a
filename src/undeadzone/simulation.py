"""Run a scenario: exogenous signals in, the loop through an engine, a `Run` out."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from undeadzone import noise, signals, tree
from undeadzone.arrays import Floats, nonnegative, scalar
from undeadzone.design.passivity import Certificate, certify
from undeadzone.design.structure import identifiable
from undeadzone.engine import interpret
from undeadzone.feedforward import Target, inverted_targets, linear_targets
from undeadzone.loop import Loop, Outputs, close
from undeadzone.problem import Problem, resolve_scenario
from undeadzone.run import Info, Run
from undeadzone.scenario import Scenario
from undeadzone.sensor import zone

NUDGE = 1e-9  # of a step: corners of a reference on the grid belong to the step that follows them


def simulate(scenario: Scenario, *, check_step: bool = True, progress: Callable[[int], None] | None = None) -> Run:
    """Simulate a scenario on CasADi's virtual machine.

    check_step: in continuous time, run again with half the step and report the difference as `integration_error`.
    progress: called with the number of steps just done. Raises InputError and its kinds for what is wrong.
    """
    began = time.perf_counter()
    problem = resolve_scenario(scenario)
    loop, state, exogenous = prepare(problem)
    signal = run_loop(loop, state, exogenous, progress)
    error = None
    if check_step and problem.plant.Ts is None:
        halved = loop._replace(params=loop.params._replace(h=loop.params.h / 2))
        finer = run_loop(halved, state, _exogenous(problem, 2), progress)
        error = _difference(signal, Outputs(*(part[::2] for part in finer)))
    return _result(problem, signal, error, began)


def prepare(problem: Problem) -> tuple[Loop, Floats, Floats]:
    """(the closed loop, its initial state with the plant at x0, exogenous inputs (steps + 1 rows))."""
    loop = close(problem.plant, problem.sensor, problem.observer, problem.controller, len(problem.tracked), problem.scenario.simulation.step)
    return loop, tree.pack(loop.state._replace(plant=problem.x0)), _exogenous(problem, 1)


def run_loop(loop: Loop, state: Floats, exogenous: Floats, progress: Callable[[int], None] | None = None) -> Outputs:
    """The outputs of a loop from a packed state along exogenous inputs, by name (rows: time)."""
    outputs, _ = interpret.run(loop.step, state, exogenous, tree.pack(loop.params), progress)
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
    start = np.zeros(problem.model.n) if eq is None else np.asarray(eq, float).ravel()
    target = inverted_targets(problem.flow, problem.reference, problem.tracked, t, start)
    if problem.model.Ts is not None:
        held = inverted_targets(problem.flow, problem.reference, problem.tracked, t + problem.model.Ts / 2, start)
        target = target._replace(u_ff=held.u_ff)
    return target


def disturbance(problem: Problem, t: Floats) -> Floats:
    """The input disturbance (len(t) x m); random ones are straight lines between samples of the time grid."""
    signal, m = problem.scenario.disturbance, problem.plant.m
    if signal is None:
        return np.zeros((t.size, m))
    if isinstance(signal, signals.Random):
        step = problem.scenario.simulation.step
        rms = nonnegative("disturbance.rms", signal.rms, m)
        correlation = scalar("disturbance.correlation_time", signal.correlation_time, above=0.0)
        knots = noise.coloured(problem.scenario.simulation.seed, problem.steps + 3, rms, correlation, step)
        grid = np.arange(problem.steps + 3) * step
        return np.stack([np.interp(t, grid, column) for column in knots.T], axis=1)
    return signals.exosystem("disturbance", signal, m).value(t)


def _difference(coarse: Outputs, fine: Outputs) -> float:
    """The largest difference of x, x^, d^ between a run and its twin of half the step."""
    gaps = [np.abs(getattr(coarse, name) - getattr(fine, name)).max() for name in ("x", "x_hat", "right", "left")]
    return float(max(gaps)) if np.isfinite(gaps).all() else float("inf")


def certificate(problem: Problem) -> Certificate | None:
    """The proof that V never rises, for observers with constant gains L, gamma on a linear model; else None."""
    params, Ts = problem.observer.params, problem.model.Ts
    if problem.model.nonlinear or not hasattr(params, "L") or not hasattr(params, "gamma"):
        return None
    per_second = 1.0 if Ts is None else 1.0 / Ts
    return certify(problem.model.linear, params.L * per_second, params.gamma * per_second, Ts)


def _result(problem: Problem, signal: Outputs, error: float | None, began: float) -> Run:
    scenario = problem.scenario
    t = np.arange(problem.steps + 1) * scenario.simulation.step
    d_hat = np.stack([signal.right, signal.left], axis=2).reshape(t.size, -1)
    truth = np.stack([problem.sensor.right, problem.sensor.left], axis=1).ravel()
    proof = certificate(problem)
    V = None
    if proof is not None and proof.certified:
        adapts = problem.sensor.kind == "deadzone" and bool((problem.observer.params.gamma > 0).all())
        gamma = problem.observer.params.gamma * (1.0 if problem.model.Ts is None else 1.0 / problem.model.Ts)
        d_error = truth - d_hat if adapts else np.zeros_like(d_hat)
        V = proof.value(signal.x - signal.x_hat, d_error, np.where(gamma > 0, gamma, 1.0))
    reached = zone(signal.z, problem.sensor.right, problem.sensor.left)
    enough = problem.model.n + 1
    verdicts = identifiable(
        problem.model.linear,
        list((reached > 0).sum(axis=0) >= enough),
        list((reached < 0).sum(axis=0) >= enough),
        problem.sensor.kind == "jump",
    )
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
            identifiable=[verdict._asdict() for verdict in verdicts],
            seconds=time.perf_counter() - began,
            units=scenario.units,
        ),
    )  # fmt: skip
