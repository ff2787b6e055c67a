"""python-control: plant, sensor, observer, controller as blocks of an interconnected system.

Run by run, by `input_output_response`.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import control
import numpy as np

from benchmarks.engine.work.paper_loop import Result, Work, grid
from undeadzone.util.arrays import Floats


def prepare(work: Work, *, rtol: float = 1e-6) -> Callable[[], Result]:
    n = len(work.B)
    times = np.concatenate([[0.0], grid(work)])
    plant = control.ss(work.A, work.B[:, None], work.C, 0, inputs="u", outputs="z", name="plant")
    names = [f"x{i}" for i in range(n)]

    def reading(t: float, s: Floats, z: Floats, d: Floats) -> Floats:
        return z - np.clip(z, -d["left"], d["right"])

    def observe(t: float, s: Floats, given: Floats, d: Floats) -> Floats:
        y, u = given
        x, right, left = s[:n], y > 0, y < 0
        e = y + s[n] * right - s[n + 1] * left - work.C @ x if y else 0.0
        x_rate = work.A @ x + work.B * u + work.L * e
        return np.concatenate([x_rate, [-work.gamma * right * e, work.gamma * left * e]])

    def control_law(t: float, s: Floats, x_hat: Floats, d: Floats) -> Floats:
        return work.wave[1] @ (math.cos(work.omega * t), math.sin(work.omega * t)) - work.K @ x_hat

    sensor = control.nlsys(None, reading, inputs="z", outputs="y", name="sensor")
    observer = control.nlsys(
        observe,
        lambda t, s, given, d: s[:n],
        inputs=["y", "u"],
        outputs=names,
        states=n + 2,
        name="observer",
    )
    controller = control.nlsys(None, control_law, inputs=names, outputs="u", name="controller")
    loop = control.interconnect([plant, sensor, observer, controller], outputs="z", inputs=None)

    def one(s: Floats, d: Floats) -> Floats:
        widths, tolerances = {"right": d[0], "left": d[1]}, {"rtol": rtol, "atol": rtol}
        response = control.input_output_response(
            loop, times, 0.0, s, params=widths, solve_ivp_kwargs=tolerances
        )
        return response.states

    def run() -> Result:
        paths = np.stack([one(s, d) for s, d in zip(work.states, work.widths, strict=True)])
        z = np.einsum("j,ijk->ik", work.C, paths[:, :n, 1:-1])
        errors = z - work.targets[-work.tail :, 0, 0]
        return Result(paths[:, :, -1], np.sqrt((errors**2).mean(axis=1)))

    return run
