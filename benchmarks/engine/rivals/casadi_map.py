"""CasADi: RK4 as an SX function, `fold` along time, `map` over runs, on its virtual machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.engine.rivals.equations import dot, rate, rk4
from benchmarks.engine.work.paper_loop import Result, Work


def prepare(work: Work) -> Callable[[], Result]:
    n, steps, runs = len(work.B), len(work.targets), len(work.states)
    state = ca.SX.sym("state", 2 * n + 5)  # s, the sum of (z - r)^2, d_r, d_l
    given = ca.SX.sym("given", 5)  # v at three instants, r, 1 in the tail
    s, d = ca.vertsplit(state[: 2 * n + 2]), ca.vertsplit(state[2 * n + 3 :])
    total = state[2 * n + 2]

    def clip(width: Any) -> Any:
        return ca.fmax(ca.fmin(width, work.limit), 0.0)

    def move(s: Any, v: Any) -> list[Any]:
        z = dot(work.C, s[:n])
        return rate(work, s, (z > d[0], z < -d[1]), d, v, clip)

    after = rk4(move, s, ca.vertsplit(given[:3]), work.step)
    error = dot(work.C, s[:n]) - given[3]
    widths = map(clip, after[2 * n :])
    following = ca.vertcat(*after[: 2 * n], *widths, total + given[4] * error**2, *d)
    step = ca.Function("step", [state, given], [following], {"cse": True})
    many = step.fold(steps).map("many", "serial", runs, [1], [])
    start = np.hstack([work.states, np.zeros((runs, 1)), work.widths]).T
    tail = np.arange(steps) >= steps - work.tail
    r = work.targets[:, 0, 0]
    v = work.targets[:, :, -1] + work.targets[:, :, 1:-1] @ work.K
    inputs = np.column_stack([v, r, tail]).T

    def run() -> Result:
        final = many(start, inputs).full().T
        return Result(final[:, : 2 * n + 2], np.sqrt(final[:, 2 * n + 2] / work.tail))

    return run
