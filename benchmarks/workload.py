"""The work that every engine is given: the paper's loop for many runs that differ in widths and initial state."""

from __future__ import annotations

from typing import Literal, NamedTuple

import msgspec
import numpy as np

import undeadzone as uz
from undeadzone.feedforward.targets import steady_state
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.simulation.simulate import prepare
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

Time = Literal["continuous", "sampled"]

PAPER = uz.Scenario(
    plant=uz.Plant(A=[[0, 1], [-1, -2]], B=[[0], [1]], C=[[1, 0]], x0=[0.5, 0]),
    sensor=uz.Sensor(right=1.0, left=1.0),
    reference=uz.Sine(amplitude=5.0, frequency=1.0),
    observer=uz.Certified(L=[1.0, 1.5], gamma=10.0, widths0=[0.2, 0.2], width_max=3.0),
    controller=uz.StateFeedback(alpha=10.0),
)


class Work(NamedTuple):
    """Numbers of a problem with one input and one output; the observer has the plant's true model.

    A, B, C, L, gamma: of the plant and the observer (per step if sampled); u = u_ff - K (x^ - x_ref); limit: of widths;
    targets (steps x 3 x (1 + n + 1)): r, x_ref, u_ff at the start, middle and end of each step [s] (sampled: 3 times the
    start's); wave, omega: r and v = u_ff + K x_ref are wave @ [cos(omega t), sin(omega t)], for solvers that choose their
    own instants; states (runs x (2 n + 2)): initial x, x^, d_r^, d_l^; widths (runs x 2): true d_r, d_l; tail: steps at
    the end over which the rms of z - r is taken, at their starts.
    """

    problem: Problem
    A: Floats
    B: Floats
    C: Floats
    L: Floats
    K: Floats
    gamma: float
    limit: float
    step: float
    targets: Floats
    wave: Floats
    omega: float
    states: Floats
    widths: Floats
    tail: int


class Result(NamedTuple):
    """Final states (runs x (2 n + 2)) and rms of z - r over the tail (runs)."""

    states: Floats
    rms: Floats


def scenario(n: int) -> uz.Scenario:
    """The paper's loop for n = 2; for other orders its plant is replaced by n equal lags in a row."""
    if n == 2:
        return PAPER
    lags = uz.Plant(
        A=6.0 * (np.eye(n, k=-1) - np.eye(n)), B=6.0 * np.eye(n)[:, :1], C=np.eye(n)[-1:]
    )
    return msgspec.structs.replace(
        PAPER, plant=lags, observer=msgspec.structs.replace(PAPER.observer, L=None)
    )


def draw(
    runs: int,
    duration: float,
    *,
    n: int = 2,
    step: float = 1e-3,
    time: Time = "continuous",
    seed: int = 0,
) -> Work:
    """Random widths and initial states for `runs` runs of `duration` [s], the first of them the paper's own.

    They are such that no estimated width reaches 0 or d_M (for n = 2): projection there is one more switch, which
    no solver here locates.
    """
    simulation = uz.Simulation(duration=duration, step=step, time=time)
    problem = resolve_scenario(msgspec.structs.replace(scenario(n), simulation=simulation))
    A, B, C = problem.plant.params
    observer, steps = problem.observer.params, problem.steps
    loop, _, exogenous = prepare(problem)
    instants = exogenous[:steps].reshape(steps, -1, tree.size(loop.instant))[:, :, : n + 2]
    x0, widths = (
        np.random.default_rng([seed, 0]).normal(0.0, 0.1, (runs, n)),
        np.random.default_rng([seed, 1]).uniform(0.5, 2.0, (runs, 2)),
    )
    states = np.hstack([x0, np.zeros((runs, n)), np.full((runs, 2), 0.2)])
    states[0, :n], widths[0] = problem.x0, 1.0
    K, exo = problem.controller.params.K, problem.reference
    Pi, Gamma = steady_state(problem.model, exo, problem.tracked)
    quarter = 0.25 / problem.scenario.reference.frequency
    wave = np.vstack([exo.Q, Gamma + K @ Pi]) @ exo.state(np.array([0.0, quarter])).T
    return Work(
        problem, A, B[:, 0], C[0], observer.L[:, 0], K[0], float(observer.gamma[0]), float(observer.limit[0]), step,
        np.ascontiguousarray(np.broadcast_to(instants, (steps, 3, n + 2))), wave, np.pi / 2 / quarter, states, widths, max(1, steps // 10),
    )  # fmt: skip


def grid(work: Work) -> Floats:
    """The instants at which the rms is taken, and the last one [s]."""
    steps = len(work.targets)
    return np.arange(steps - work.tail, steps + 1) * work.step


def final_error(found: Result, true: Result) -> float:
    """The largest error of a final state in the runs that both have."""
    runs = min(len(found.states), len(true.states))
    return float(np.abs(found.states[:runs] - true.states[:runs]).max())


def error(found: Result, true: Result) -> float:
    """The largest error of a final state or an rms in the runs that both have."""
    runs = min(len(found.rms), len(true.rms))
    return max(final_error(found, true), float(np.abs(found.rms[:runs] - true.rms[:runs]).max()))
