"""Linearisation of a model at a point, in numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats


class Tangents(NamedTuple):
    """Linearisation of a model at a point, in numbers.

    Attributes:
        move: move(x, u) is (x+, dx+/dx, dx+/du).
        output: output(x) is (C, offset), z = C x + offset.
    """

    move: Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]
    output: Callable[[Floats], tuple[Floats, Floats]]


def model_tangents(model: System) -> Tangents:
    """Return the functions that linearise a model at a point, in numbers."""
    if not model.nonlinear:
        A, B, C = model.linear
        return Tangents(lambda x, u: (A @ x + B @ u, A, B), lambda x: (C, np.zeros(model.p)))
    x = ca.SX.sym("x", model.n)
    u = ca.SX.sym("u", model.m)
    params = ca.SX(model.params)
    after = model.move(params, x, u)
    z = model.output(params, x)
    A = ca.densify(ca.jacobian(after, x))
    B = ca.densify(ca.jacobian(after, u))
    C = ca.densify(ca.jacobian(z, x))
    moved = ca.Function("move", [x, u], [after, A, B], {"cse": True})
    seen = ca.Function("output", [x], [C, z - C @ x])

    def move(x: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Return x+ (n), dx+/dx (n x n) and dx+/du (n x m)."""
        after, A, B = _to_arrays(moved(x, u))
        return after[:, 0], A, B

    def output(x: Floats) -> tuple[Floats, Floats]:
        """Return C (p x n) and offset (p) of z = C x + offset."""
        C, offset = _to_arrays(seen(x))
        return C, offset[:, 0]

    return Tangents(move, output)


def _to_arrays(parts: Any) -> list[Floats]:
    """Convert the results of a CasADi function to arrays."""
    return [part.full() for part in parts]
