"""JAX: RK4 in `lax.scan`, `vmap` over runs, 64 bits, compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.engine.rivals.equations import dot, rate, rk4
from benchmarks.engine.work.paper_loop import Result, Work

jax.config.update("jax_enable_x64", True)


def prepare(work: Work, *, unroll: int = 1) -> Callable[[], Result]:
    """unroll: steps per turn of the scan; more help a single run only."""
    n, steps = len(work.B), len(work.targets)
    v = work.targets[:, :, -1] + work.targets[:, :, 1:-1] @ work.K
    tail = np.arange(steps) >= steps - work.tail

    def clip(width: Any) -> Any:
        return jnp.clip(width, 0.0, work.limit)

    def one(s: Any, d: Any) -> Any:
        def move(s: Any, v: Any) -> list[Any]:
            z = dot(work.C, s[:n])
            return rate(work, s, (1.0 * (z > d[0]), 1.0 * (z < -d[1])), d, v, clip)

        def step(carry: Any, given: Any) -> Any:
            (s, total), (v, r, counts) = carry, given
            after = rk4(move, s, v, work.step)
            return (
                [*after[: 2 * n], *map(clip, after[2 * n :])],
                total + counts * (dot(work.C, s[:n]) - r) ** 2,
            ), None

        (s, total), _ = jax.lax.scan(
            step, (list(s), 0.0), (v, work.targets[:, 0, 0], 1.0 * tail), unroll=unroll
        )
        return jnp.stack(s), total

    many = jax.jit(jax.vmap(one))

    def run() -> Result:
        states, total = many(work.states, work.widths)
        return Result(np.asarray(states), np.sqrt(np.asarray(total) / work.tail))

    return run
