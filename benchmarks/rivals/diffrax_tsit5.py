"""Diffrax: Tsit5, adaptive or with constant steps, `vmap` over runs, 64 bits, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.rivals.equations import dot, rate
from benchmarks.workload import Result, Work, grid

jax.config.update("jax_enable_x64", True)


def prepare(work: Work, *, rtol: float | None = 1e-6) -> Callable[[], Result]:
    """rtol = None: constant steps."""
    n, end = len(work.B), len(work.targets) * work.step
    constant = rtol is None
    controller = (
        diffrax.ConstantStepSize() if constant else diffrax.PIDController(rtol=rtol, atol=rtol)
    )
    found = diffrax.SaveAt(
        subs=[
            diffrax.SubSaveAt(t1=True),
            diffrax.SubSaveAt(ts=grid(work)[:-1], fn=lambda t, s, d: dot(work.C, s[:n])),
        ]
    )

    def move(t: Any, s: Any, d: Any) -> list[Any]:
        z = dot(work.C, s[:n])
        v = work.wave[1, 0] * jnp.cos(work.omega * t) + work.wave[1, 1] * jnp.sin(work.omega * t)
        return rate(work, s, (1.0 * (z > d[0]), 1.0 * (z < -d[1])), d, v)

    def one(s: Any, d: Any) -> Any:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(move), diffrax.Tsit5(), 0.0, end, work.step, list(s), d, saveat=found, stepsize_controller=controller, max_steps=None,
        )  # fmt: skip
        states, z = solution.ys
        return jnp.concatenate(states), jnp.sqrt(
            jnp.mean((z - work.targets[-work.tail :, 0, 0]) ** 2)
        )

    many = jax.jit(jax.vmap(one))
    return lambda: Result(*map(np.asarray, many(work.states, work.widths)))
