"""Diffrax: Tsit5, adaptive or with constant steps, `vmap` over runs, 64 bits, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.engine.rivals.equations import dot, rate
from benchmarks.engine.work.paper_loop import Result, Work, grid

jax.config.update("jax_enable_x64", True)


def prepare(work: Work, *, rtol: float | None = 1e-6) -> Callable[[], Result]:
    """The work made ready; rtol = None: constant steps."""
    n, end = len(work.B), len(work.targets) * work.step
    if rtol is None:
        controller = diffrax.ConstantStepSize()
    else:
        controller = diffrax.PIDController(rtol=rtol, atol=rtol)

    def output(t: Any, s: Any, d: Any) -> Any:
        return dot(work.C, s[:n])

    last = diffrax.SubSaveAt(t1=True)
    outputs = diffrax.SubSaveAt(ts=grid(work)[:-1], fn=output)
    save = diffrax.SaveAt(subs=[last, outputs])

    def move(t: Any, s: Any, d: Any) -> list[Any]:
        z = dot(work.C, s[:n])
        v = work.wave[1, 0] * jnp.cos(work.omega * t) + work.wave[1, 1] * jnp.sin(work.omega * t)
        return rate(work, s, (1.0 * (z > d[0]), 1.0 * (z < -d[1])), d, v)

    def one(s: Any, d: Any) -> Any:
        solution = diffrax.diffeqsolve(
            terms=diffrax.ODETerm(move),
            solver=diffrax.Tsit5(),
            t0=0.0,
            t1=end,
            dt0=work.step,
            y0=list(s),
            args=d,
            saveat=save,
            stepsize_controller=controller,
            max_steps=None,
        )
        states, z = solution.ys
        errors = z - work.targets[-work.tail :, 0, 0]
        return jnp.concatenate(states), jnp.sqrt(jnp.mean(errors**2))

    many = jax.jit(jax.vmap(one))
    return lambda: Result(*map(np.asarray, many(work.states, work.widths)))
