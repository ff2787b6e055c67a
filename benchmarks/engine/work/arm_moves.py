"""The work of every simulator of arms, and ours: UR5 that differ in initial state and torque."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import casadi as ca
import numpy as np

from undeadzone.compile import interpret, lanes
from undeadzone.numerics.runge_kutta import rk4
from undeadzone.plants.robots import urdf
from undeadzone.plants.robots.arm import build_arm, forward_dynamics, inverse_dynamics
from undeadzone.util.arrays import Floats
from undeadzone_studies.ensemble.batch import constant_params

UR5 = Path(__file__).parents[3] / "examples" / "ur5.urdf"
JOINTS = 6
Move = Literal["euler", "rk4", "follow"]
MOVES = get_args(Move)


class Work(NamedTuple):
    """What is simulated.

    Attributes:
        path: the arm's URDF
        move: euler: q' += step * q'', then q += step * q', one evaluation of the dynamics; rk4:
            four; follow: RK4 under computed torque on the true state, one of the inverse dynamics
            besides
        step: [s]
        states: initial q, q' (runs x 2 N)
        torques: constant (runs x N)
        targets: q, q', q'' to follow (steps x 3 x N)
        gains: of computed torque [1/s^2, 1/s]
    """

    path: Path
    move: Move
    step: float
    states: Floats
    torques: Floats
    targets: Floats
    gains: tuple[float, float]

    @property
    def steps(self) -> int:
        """How many."""
        return len(self.targets)


def draw(move: Move, runs: int, steps: int, step: float = 1e-3) -> Work:
    """The first `runs` of random arms."""
    t = step * np.arange(steps)
    target = np.stack([0.5 * np.sin(3 * t), 1.5 * np.cos(3 * t), -4.5 * np.sin(3 * t)], axis=1)
    starts = np.random.default_rng([0, 0]).normal(size=(runs, 2 * JOINTS))
    torques = np.random.default_rng([0, 1]).normal(size=(runs, JOINTS))
    targets = np.ascontiguousarray(np.broadcast_to(target[..., None], (steps, 3, JOINTS)))
    return Work(UR5, move, step, starts, torques, targets, (100.0, 20.0))


def lanes_run(work: Work, *, width: int = lanes.WIDTH, threads: int = 1) -> Callable[[], Floats]:
    """Ours on the lanes engine."""
    step, params, own = _graph(work)
    kernel = lanes.build_kernel(
        step,
        params=own,
        record=[],
        known_params=constant_params(params, own),
        width=width,
        fused=True,
    )
    inputs = work.targets.reshape(work.steps, -1)

    def run() -> Floats:
        _, finals = lanes.run_lanes(
            kernel, work.states, inputs, params, None, work.torques, threads=threads
        )
        return finals

    return run


def virtual_machine(work: Work) -> Callable[[], Floats]:
    """Ours on CasADi's virtual machine, one arm after the other."""
    step, params, own = _graph(work)
    inputs = work.targets.reshape(work.steps, -1)
    numbers = [np.concatenate([params[: own[0]], torques]) for torques in work.torques]

    def run() -> Floats:
        finals = []
        for state, p in zip(work.states, numbers, strict=True):
            finals.append(interpret.run_interpreted(step, state, inputs, p)[1])
        return np.stack(finals)

    return run


def _graph(work: Work) -> tuple[ca.Function, Floats, tuple[int, ...]]:
    """next, out = step(s, w, p), with p and which of it are the torques."""
    body = build_arm(urdf.load_urdf_chain(work.path))
    N, first = body.joint_count, len(body.names)
    s, w, p = ca.SX.sym("s", 2 * N), ca.SX.sym("w", 3 * N), ca.SX.sym("p", first + N)
    params, u = p[:first], p[first:]

    def rate(x: Any, u: Any) -> Any:
        return ca.vertcat(x[N:], forward_dynamics(body, params, x[:N], x[N:], u))

    if work.move == "euler":
        v = s[N:] + work.step * rate(s, u)[N:]
        following = ca.vertcat(s[:N] + work.step * v, v)
    else:
        torque = u
        if work.move == "follow":
            q, v, a = ca.vertsplit(w, N)
            k_p, k_d = work.gains
            acceleration = a + k_p * (q - s[:N]) + k_d * (v - s[N:])
            torque = inverse_dynamics(body, params, s[:N], s[N:], acceleration)
        following = rk4(lambda x, _: rate(x, torque), s, work.step)
    names = (["s", "w", "p"], ["next", "out"])
    step = ca.Function("arm", [s, w, p], [following, ca.SX(0, 1)], *names, {"cse": True})
    return step, np.concatenate([body.values, np.zeros(N)]), tuple(range(first, first + N))
