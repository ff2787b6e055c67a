"""The Jacobian of a model and true bounds on it, on boxes of states and inputs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine.interval import Interval, enclosure
from undeadzone.errors import InputError
from undeadzone.plants.region import Box
from undeadzone.plants.system import System
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers


class Slopes(NamedTuple):
    """A = df/dx (delta form if sampled) of a model at points (N x (n + m)) -> N x n x n, and what bounds it, which takes time to make.

    entries: rows and columns of A that vary (K); bounds(): functions of boxes (N rows) that bound these entries (N x 1 x K), and
    their derivatives (N x (n + m) x K).
    """

    at: Callable[[Floats], Floats]
    entries: tuple[Integers, Integers]
    bounds: Callable[[], tuple[Callable[[Box], Interval], Callable[[Box], Interval]]]


def slopes_on(model: System, box: Box) -> Slopes:
    """The Jacobian of a model; its bounds raise InputError where the model is not smooth on a box. Raises InputError where the output bends."""
    n = model.n
    p, params = tree.symbols(model.params, "p")
    w = ca.SX.sym("w", n + model.m)
    moved, z = model.move(params, w[:n], w[n:]), model.output(params, w[:n])
    if any(ca.which_depends(z, w, 2, True)):
        raise InputError("region: a certificate needs outputs that are affine in the state")
    A = ca.densify(ca.jacobian(moved, w)[:, :n])
    A = A if model.Ts is None else (A - np.eye(n)) / model.Ts
    varying = np.flatnonzero(ca.which_depends(ca.vec(A), w, 1, True))
    columns, rows = np.divmod(varying, n)
    numbers = tree.pack(model.params)[:, None]

    def function(*values: ca.SX) -> ca.Function:
        return ca.Function("slopes", [p, w], list(values), {"cse": True})

    everything = function(moved, A)

    def at(points: Floats) -> Floats:
        found = everything(np.broadcast_to(numbers, (numbers.size, len(points))), points.T)[
            1
        ].full()
        return found.reshape(n, len(points), n).transpose(1, 0, 2)

    def bounded(value: ca.SX) -> Callable[[Box], Interval]:
        bound, shape = enclosure(function(value)), (-1, *value.shape[::-1])

        def bounds(part: Box) -> Interval:
            (found,) = bound([Interval(numbers, numbers), Interval(part.low.T, part.high.T)])
            return Interval(found.low.T.reshape(shape), found.high.T.reshape(shape))

        return bounds

    @functools.cache
    def bounds() -> tuple[Callable[[Box], Interval], Callable[[Box], Interval]]:
        some = ca.vec(A)[varying.tolist()]
        try:
            enclosure(everything)(
                [Interval(numbers, numbers), Interval(box.low[:, None], box.high[:, None])]
            )
            return bounded(some), bounded(ca.densify(ca.jacobian(some, w)))
        except InputError as error:
            raise InputError(f"region: the model cannot be certified on it: {error}") from None

    return Slopes(at, (rows, columns), bounds)
