"""SciPy's `solve_ivp`, run by run.

As it comes, or stopped and restarted at each change of side (events).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.engine.rivals.equations import dot, rate
from benchmarks.engine.work.paper_loop import Result, Work, grid
from undeadzone.util.arrays import Floats


def prepare(
    work: Work, *, rtol: float = 1e-6, method: str = "RK45", events: bool = False
) -> Callable[[], Result]:
    n, end, times = len(work.B), len(work.targets) * work.step, grid(work)
    options = {"rtol": rtol, "atol": rtol, "method": method}

    def output(s: Floats) -> float:
        return dot(work.C, s[:n])

    def move(t: float, s: Floats, d: Floats, on: tuple[float, float] | None) -> list[float]:
        v = work.wave[1, 0] * math.cos(work.omega * t) + work.wave[1, 1] * math.sin(work.omega * t)
        on = on or sides(s, d)
        return rate(work, s.tolist(), on, d, v)

    def sides(s: Floats, d: Floats) -> tuple[float, float]:
        return 1.0 * (output(s) > d[0]), 1.0 * (output(s) < -d[1])

    def smooth(s: Floats, d: Floats) -> Floats:
        return solve_ivp(move, (0.0, end), s, args=(d, None), t_eval=times, **options).y

    def switched(s: Floats, d: Floats) -> Floats:
        t, on = 0.0, sides(s, d)
        parts = []
        while t < end:
            edges = [
                _edge(lambda s: output(s) - d[0], 1 - 2 * on[0]),
                _edge(lambda s: output(s) + d[1], 2 * on[1] - 1),
            ]
            ahead = times[times > t]
            part = solve_ivp(move, (t, end), s, args=(d, on), t_eval=ahead, events=edges, **options)
            if len(part.t):
                parts.append(part.y)
            right, left = (instants.size > 0 for instants in part.t_events)
            if not (right or left):
                break
            first = 0 if right else 1
            t, s = part.t_events[first][0], part.y_events[first][0]
            on = (1 - on[0] if right else on[0], 1 - on[1] if left else on[1])
        return np.hstack(parts)

    def run() -> Result:
        solve = switched if events else smooth
        pairs = zip(work.states, work.widths, strict=True)
        paths = np.stack([solve(s, d.tolist()) for s, d in pairs])
        z = np.einsum("j,ijk->ik", work.C, paths[:, :n, :-1])
        errors = z - work.targets[-work.tail :, 0, 0]
        return Result(paths[:, :, -1], np.sqrt((errors**2).mean(axis=1)))

    return run


def _edge(value: Callable[[Floats], float], direction: float) -> Callable[..., float]:
    """A terminal event where `value` changes sign in a direction."""

    def event(t: float, s: Floats, *args: object) -> float:
        return value(s)

    vars(event).update(terminal=True, direction=direction)
    return event
