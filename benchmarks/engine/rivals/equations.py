"""The loop's equations entry by entry, on numbers or on the expressions of any library."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.engine.work.paper_loop import Work


def dot(row: Sequence[float], x: Sequence[Any]) -> Any:
    """row @ x without the terms that are 0."""
    terms = [float(a) * b for a, b in zip(row, x, strict=True) if a != 0]
    return functools.reduce(operator.add, terms)


def rate(
    work: Work,
    s: Sequence[Any],
    on: tuple[Any, Any],
    d: Sequence[Any],
    v: Any,
    clip: Callable[[Any], Any] = lambda width: width,
) -> list[Any]:
    """s' of s = [x, x^, d_r^, d_l^] for u = v - K x^.

    Args:
        work: has the numbers
        s: the states
        on: 1 on the (right, left) side, else 0
        d: true d_r, d_l
        v: u_ff + K x_ref
        clip: a width to [0, d_M]
    """
    n = len(work.B)
    x, x_hat = s[:n], s[n : 2 * n]
    right, left = (clip(width) for width in s[2 * n :])
    z_error = dot(work.C, x) - dot(work.C, x_hat)
    e = (on[0] + on[1]) * z_error - on[0] * (d[0] - right) + on[1] * (d[1] - left)
    u = v - dot(work.K, x_hat)
    plant, observer = [], []
    for row, b, gain in zip(work.A, work.B, work.L, strict=True):
        plant.append(dot(row, x) + float(b) * u if b else dot(row, x))
        observer.append(dot(row, x_hat) + float(b) * u + float(gain) * e)
    return [*plant, *observer, -work.gamma * on[0] * e, work.gamma * on[1] * e]


def rk4(
    move: Callable[[Sequence[Any], Any], list[Any]], s: Sequence[Any], v: Sequence[Any], h: float
) -> list[Any]:
    """A step of s' = move(s, v), v given at its start, middle and end."""

    def ahead(part: float, k: Sequence[Any]) -> list[Any]:
        return [a + part * h * b for a, b in zip(s, k, strict=True)]

    k1 = move(s, v[0])
    k2 = move(ahead(0.5, k1), v[1])
    k3 = move(ahead(0.5, k2), v[1])
    k4 = move(ahead(1.0, k3), v[2])
    slopes = zip(k1, k2, k3, k4, strict=True)
    return ahead(1 / 6, [a + 2 * b + 2 * c + e for a, b, c, e in slopes])
