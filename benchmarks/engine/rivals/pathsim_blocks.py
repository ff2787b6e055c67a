"""PathSim: the loop as a block diagram, RK4 with constant steps, run by run."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pathsim import Connection, Simulation
from pathsim.blocks import ODE, Function, Scope, Source
from pathsim.solvers import RK4

from benchmarks.engine.work.paper_loop import Result, Work
from undeadzone.util.arrays import Floats


def prepare(work: Work) -> Callable[[], Result]:
    n, end = len(work.B), len(work.targets) * work.step

    def observe(s: Floats, given: Floats, t: float) -> Floats:
        (y, u), x = given, s[:n]
        right, left = np.clip(s[n:], 0.0, work.limit)
        e = y + right * (y > 0) - left * (y < 0) - work.C @ x if y else 0.0
        x_rate = work.A @ x + work.B * u + work.L * e
        return np.concatenate([x_rate, [-work.gamma * (y > 0) * e, work.gamma * (y < 0) * e]])

    def beyond(z: float, d: Floats) -> float:
        return z - min(max(z, -d[1]), d[0])

    def aim(t: float) -> float:
        angle = work.omega * t
        return work.wave[1, 0] * math.cos(angle) + work.wave[1, 1] * math.sin(angle)

    def one(s: Floats, d: Floats) -> tuple[Floats, float]:
        plant = ODE(lambda x, u, t: work.A @ x + work.B * u, s[:n])
        observer = ODE(observe, s[n:])
        sensor = Function(lambda *x: beyond(work.C @ x, d))
        target = Source(aim)
        controller = Function(lambda v, *x_hat: v - work.K @ x_hat)
        scope = Scope(t_wait=end - (work.tail + 0.5) * work.step)
        links = [
            *(Connection(plant[i], sensor[i], scope[i]) for i in range(n)),
            *(Connection(observer[i], controller[i + 1]) for i in range(n)),
            Connection(sensor, observer[0]),
            Connection(target, controller),
            Connection(controller, plant, observer[1]),
        ]
        blocks = [plant, observer, sensor, target, controller, scope]
        Simulation(blocks, links, dt=work.step, Solver=RK4, log=False).run(end, adaptive=False)
        _, path = scope.read()
        errors = work.C @ np.array(path)[:, : work.tail] - work.targets[-work.tail :, 0, 0]
        states = np.concatenate([plant.engine.get(), observer.engine.get()])
        return states, math.sqrt(np.mean(errors**2))

    def run() -> Result:
        runs = [one(s, d) for s, d in zip(work.states, work.widths, strict=True)]
        states, rms = zip(*runs, strict=True)
        return Result(np.array(states), np.array(rms))

    return run
