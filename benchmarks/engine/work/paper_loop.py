"""The work of every engine: the paper's loop for runs that differ in widths and initial state."""

from __future__ import annotations

from typing import Literal, NamedTuple

import msgspec
import numpy as np

import undeadzone as uz
from undeadzone.feedforward.targets import steady_state
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.simulation.simulate import prepare
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

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

    Attributes:
        problem: the problem itself
        A, B, C: of the plant (per step if sampled)
        L, gamma: of the observer (per step if sampled)
        K: of the controller, u = u_ff - K (x^ - x_ref)
        limit: of widths
        step: [s]
        targets: r, x_ref, u_ff at the start, middle and end of each step (sampled: 3 times the
            start's) (steps x 3 x (1 + n + 1))
        wave, omega: r and v = u_ff + K x_ref are wave @ [cos(omega t), sin(omega t)], for solvers
            that choose their own instants
        states: initial x, x^, d_r^, d_l^ (runs x (2 n + 2))
        widths: true d_r, d_l (runs x 2)
        tail: steps at the end over which the rms of z - r is taken, at their starts
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
    """The paper's loop for n = 2; for other orders n equal lags in a row are its plant."""
    if n == 2:
        return PAPER
    A = 6.0 * (np.eye(n, k=-1) - np.eye(n))
    lags = uz.Plant(A=A, B=6.0 * np.eye(n)[:, :1], C=np.eye(n)[-1:])
    observer = msgspec.structs.replace(PAPER.observer, L=None)
    return msgspec.structs.replace(PAPER, plant=lags, observer=observer)


def draw(
    runs: int,
    duration: float,
    *,
    n: int = 2,
    step: float = 1e-3,
    time: Time = "continuous",
    seed: int = 0,
) -> Work:
    """Random widths and initial states of runs, the first of them the paper's own.

    They are such that no estimated width reaches 0 or d_M (for n = 2): projection there is one more
    switch, which no solver here locates.

    Args:
        runs: how many
        duration: of each [s]
        n: order of the plant
        step: [s]
        time: continuous or sampled
        seed: of widths and states
    """
    simulation = uz.Simulation(duration=duration, step=step, time=time)
    problem = resolve_scenario(msgspec.structs.replace(scenario(n), simulation=simulation))
    A, B, C = problem.plant.params
    observer, steps = problem.observer.params, problem.steps
    loop, _, exogenous = prepare(problem)
    instants = exogenous[:steps].reshape(steps, -1, tree.count_numbers(loop.instant))[:, :, : n + 2]
    x0 = np.random.default_rng([seed, 0]).normal(0.0, 0.1, (runs, n))
    widths = np.random.default_rng([seed, 1]).uniform(0.5, 2.0, (runs, 2))
    states = np.hstack([x0, np.zeros((runs, n)), np.full((runs, 2), 0.2)])
    states[0, :n], widths[0] = problem.x0, 1.0
    K, exo = problem.controller.params.K, problem.reference
    Pi, Gamma = steady_state(problem.model, exo, problem.tracked)  # x_ref = Pi w, u_ff = Gamma w
    quarter = 0.25 / problem.scenario.reference.frequency  # [s] of a period
    wave = np.vstack([exo.Q, Gamma + K @ Pi]) @ exo.state(np.array([0.0, quarter])).T
    return Work(
        problem=problem,
        A=A,
        B=B[:, 0],
        C=C[0],
        L=observer.L[:, 0],
        K=K[0],
        gamma=float(observer.gamma[0]),
        limit=float(observer.limit[0]),
        step=step,
        targets=np.ascontiguousarray(np.broadcast_to(instants, (steps, 3, n + 2))),
        wave=wave,
        omega=np.pi / 2 / quarter,
        states=states,
        widths=widths,
        tail=max(1, steps // 10),
    )


def grid(work: Work) -> Floats:
    """The instants at which the rms is taken, and the last one [s]."""
    steps = len(work.targets)
    return np.arange(steps - work.tail, steps + 1) * work.step


def final_error(result: Result, true: Result) -> float:
    """The largest error of a final state in the runs that both have."""
    runs = min(len(result.states), len(true.states))
    return float(np.abs(result.states[:runs] - true.states[:runs]).max())


def error(result: Result, true: Result) -> float:
    """The largest error of a final state or an rms in the runs that both have."""
    runs = min(len(result.rms), len(true.rms))
    of_rms = float(np.abs(result.rms[:runs] - true.rms[:runs]).max())
    return max(final_error(result, true), of_rms)
