"""The Jacobian of a model, and true bounds on it, on boxes of states and inputs."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile.interval import Interval, enclosure
from undeadzone.errors import InputError
from undeadzone.plants.region import Box
from undeadzone.plants.system import System
from undeadzone.support import tree
from undeadzone.support.arrays import Floats, Integers

Bounds = Callable[[Box], Interval]


class Slopes(NamedTuple):
    """A = df/dx (delta form if sampled) of a model with n states and m inputs, and its bounds.

    Attributes:
        at: points [x, u] (N x (n + m)) -> A there (N x n x n).
        entries: rows and columns of the entries of A that vary (K each).
        bounds: makes two functions of boxes (N rows), which takes time: the first bounds these
            entries (N x 1 x K), the second their derivatives (N x (n + m) x K).
    """

    at: Callable[[Floats], Floats]
    entries: tuple[Integers, Integers]
    bounds: Callable[[], tuple[Bounds, Bounds]]


def slopes_on(model: System, box: Box) -> Slopes:
    """The Jacobian of a model, with bounds on parts of a box.

    Args:
        model: the model, its outputs affine in the state.
        box: of [x, u] (n + m).

    Raises:
        InputError: where the output bends; from the bounds, where the model is not smooth.
    """
    n = model.n
    p, params = tree.symbols(model.params, "p")
    w = ca.SX.sym("w", n + model.m)  # [x, u]
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
        repeated = np.broadcast_to(numbers, (numbers.size, len(points)))
        side_by_side = everything(repeated, points.T)[1].full()
        return side_by_side.reshape(n, len(points), n).transpose(1, 0, 2)

    @functools.cache
    def bounds() -> tuple[Bounds, Bounds]:
        some = ca.vec(A)[varying.tolist()]
        whole = [Interval(numbers, numbers), Interval(box.low[:, None], box.high[:, None])]
        try:
            enclosure(everything)(whole)  # raises where the model is not smooth
            bends = ca.densify(ca.jacobian(some, w))
            return _bounded(function(some), numbers), _bounded(function(bends), numbers)
        except InputError as error:
            raise InputError(f"region: the model cannot be certified on it: {error}") from None

    return Slopes(at, (rows, columns), bounds)


def _bounded(function: ca.Function, numbers: Floats) -> Bounds:
    """Bounds on a function of (p, [x, u]) over boxes of [x, u], one box a row.

    numbers: values of p, as a column. A value (r x c) comes back as (c x r) for each box.
    """
    bound = enclosure(function)
    shape = (-1, *function.size_out(0)[::-1])

    def bounds(part: Box) -> Interval:
        (value,) = bound([Interval(numbers, numbers), Interval(part.low.T, part.high.T)])
        return Interval(value.low.T.reshape(shape), value.high.T.reshape(shape))

    return bounds
