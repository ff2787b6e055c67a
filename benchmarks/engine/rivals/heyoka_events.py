"""heyoka: Taylor's method compiled for this loop, each change of side a terminal event.

Widths that reach 0 or d_M are not projected.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import heyoka as hy
import numpy as np

from benchmarks.engine.rivals.equations import dot, rate
from benchmarks.engine.work.paper_loop import Result, Work, grid

ON_RIGHT, ON_LEFT, RIGHT, LEFT = range(4)  # parameters: the side and the true widths


def prepare(work: Work, *, tol: float = 1e-9, batch: bool = False) -> Callable[[], Result]:
    """The work made ready; batch: as many runs at once as the CPU's vectors hold."""
    n, times = len(work.B), grid(work)
    s = hy.make_vars(*(f"s{i}" for i in range(2 * n + 2)))
    angle = work.omega * hy.time
    v = float(work.wave[1, 0]) * hy.cos(angle) + float(work.wave[1, 1]) * hy.sin(angle)
    z, par = dot(work.C, s[:n]), hy.par
    rates = rate(work, s, (par[ON_RIGHT], par[ON_LEFT]), (par[RIGHT], par[LEFT]), v)
    equations = list(zip(s, rates, strict=True))

    def enter(index: int, inward: int) -> Callable[..., bool]:
        def callback(solver: Any, direction: int, *place: int) -> bool:
            solver.pars[(index, *place)] = float(direction == inward)
            return True

        return callback

    if batch:
        size = hy.recommended_simd_size()
        shape: tuple[int, ...] = (size,)
        make, event = hy.taylor_adaptive_batch, hy.t_event_batch
        instants = np.tile(times[:, None], (1, size))
    else:
        size, shape = 1, ()
        make, event = hy.taylor_adaptive, hy.t_event
        instants = times
    events = [
        event(z - par[RIGHT], callback=enter(ON_RIGHT, 1)),
        event(z + par[LEFT], callback=enter(ON_LEFT, -1)),
    ]
    integrator = make(
        equations,
        np.zeros((2 * n + 2, *shape)),
        pars=np.zeros((4, *shape)),
        tol=tol,
        t_events=events,
    )

    def run() -> Result:
        result = Result(np.empty_like(work.states), np.empty(len(work.states)))
        last = len(work.states) - 1
        for first in range(0, len(work.states), size):
            lanes = np.minimum(np.arange(first, first + size), last) if batch else first
            states, (right, left) = work.states[lanes].T, work.widths[lanes].T
            z0 = work.C @ states[:n]
            if batch:
                integrator.set_time(0.0)
            else:
                integrator.time = 0.0
            integrator.state[:] = states
            integrator.pars[:] = [z0 > right, z0 < -left, right, left]
            integrator.reset_cooldowns()
            integrator.propagate_until(times[0])
            path = integrator.propagate_grid(instants)[-1]  # instants x states (x lanes)
            z_tail = np.tensordot(work.C, path[:-1, :n], (0, 1)).T
            errors = z_tail - work.targets[-work.tail :, 0, 0]
            result.states[lanes] = path[-1].T
            result.rms[lanes] = np.sqrt((errors**2).mean(axis=-1))
        return result

    return run
