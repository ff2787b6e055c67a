"""Plants: x' = f(x, u), z = h(x); linear ones (14), (15), (37)-(39) and known nonlinear ones share one shape, `System`."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.linear.matrices import Matrices, companion
from undeadzone.plants import formulas as expression
from undeadzone.plants.options import Plant, TransferFunction
from undeadzone.plants.system import System, linearise
from undeadzone.support.arrays import LARGEST, Floats, matrix, scalar, series, vector

# Each form by its leading key, and the keys that belong to it.
_FORMS = {
    "A": ("B", "C"),
    "second_order": (),
    "companion": (),
    "integrators": (),
    "transfer_function": (),
    "f": ("h", "states", "inputs", "parameters", "x_eq", "u_eq"),
    "arm": ("parameters", "x_eq", "u_eq"),
}


def _transfer_function(key: str, given: TransferFunction) -> Matrices:
    num, den = (
        np.trim_zeros(series(f"{key}.{name}", getattr(given, name)), "f")
        for name in ("numerator", "denominator")
    )
    if den.size < 2 or num.size == 0:
        raise InputError(f"{key}: needs a non-zero numerator and a denominator of order 1 or more")
    if num.size >= den.size:
        raise InputError(
            f"{key}: must be strictly proper (numerator order {num.size - 1} < denominator order {den.size - 1})"
        )
    with np.errstate(over="ignore"):
        return companion((den / den[0])[:0:-1], (num / den[0])[::-1])


def matrices(plant: Plant, key: str = "plant") -> Matrices:
    """The matrices of a linear plant given in any form. Raises InputError, ShapeError."""
    if plant.second_order is not None:
        zeta, gain = (
            scalar(f"{key}.second_order.{name}", getattr(plant.second_order, name))
            for name in ("zeta", "gain")
        )
        omega = scalar(f"{key}.second_order.omega_n", plant.second_order.omega_n, above=0.0)
        found = companion([omega * omega, 2 * zeta * omega])
        return found._replace(B=gain * found.B)
    if plant.companion is not None:
        return companion(series(f"{key}.companion", plant.companion))
    if plant.integrators is not None:
        if not 1 <= plant.integrators <= 50:
            raise InputError(f"{key}.integrators: expected 1 to 50, found {plant.integrators}")
        return companion(np.zeros(plant.integrators))
    if plant.transfer_function is not None:
        return _transfer_function(f"{key}.transfer_function", plant.transfer_function)
    if plant.f is not None or plant.arm is not None:
        raise InputError(f"{key}: is nonlinear; matrices A, B, C exist for a linear plant only")
    for name in "ABC":
        if getattr(plant, name) is None:
            raise InputError(
                f"{key}.{name}: missing; a linear plant needs A (n x n), B (n x m) and C (p x n)"
            )
    A = matrix(f"{key}.A", plant.A)
    n = A.shape[0]
    A = matrix(f"{key}.A", plant.A, n, n, "A must be square")
    return Matrices(
        A,
        matrix(f"{key}.B", plant.B, n, None, f"as many rows as A, {n}"),
        matrix(f"{key}.C", plant.C, None, n, f"as many columns as A, {n}"),
    )


def system(plant: Plant, key: str = "plant") -> System:
    """The continuous-time `System` of a plant. Raises InputError, ShapeError that name the key."""
    given = [form for form in _FORMS if getattr(plant, form) is not None]
    if len(given) != 1:
        found = f"found {' and '.join(given)}" if given else "found none"
        raise InputError(f"{key}: give exactly one form ({', '.join(_FORMS)}), {found}")
    known = {given[0], *_FORMS[given[0]], "x0"}
    present = [
        name
        for name in Plant.__struct_fields__
        if not (getattr(plant, name) is None or (name == "parameters" and not plant.parameters))
    ]
    if unused := [name for name in present if name not in known]:
        raise InputError(
            f"{key}.{unused[0]}: has no meaning for a plant given by {given[0]}; remove one of them"
        )
    if plant.f is not None:
        return _nonlinear(plant, key)
    if plant.arm is not None:
        from undeadzone.plants.robots.build import robot

        return robot(plant, plant.arm, key)
    linear = matrices(plant, key)
    if not all(np.abs(part).max() < LARGEST**2 for part in linear):
        raise InputError(f"{key}.{given[0]}: its numbers are too far apart to compute with")
    return System(linear, _linear_move, _linear_output, linear, nonlinear=False)


def initial_state(plant: Plant, n: int, key: str = "plant") -> Floats:
    """x(0), zeros if not given. Raises ShapeError."""
    return np.zeros(n) if plant.x0 is None else vector(f"{key}.x0", plant.x0, n, "one per state")


def _linear_move(params: Matrices, x: Any, u: Any) -> Any:
    return params.A @ x + params.B @ u


def _linear_output(params: Matrices, x: Any) -> Any:
    return params.C @ x


def _nonlinear(plant: Plant, key: str) -> System:
    names = list(plant.parameters)
    if callable(plant.f) != callable(plant.h):
        raise InputError(f"{key}: f and h must both be formulas or both be callables")
    if callable(plant.f):
        if plant.states is not None:
            n = len(plant.states)
        elif plant.x0 is not None:
            n = np.size(plant.x0)
        else:
            raise InputError(
                f"{key}: a plant given by callables needs x0 or states, to know its order"
            )
        m = len(plant.inputs) if plant.inputs is not None else 1

        def move(params: Any, x: Any, u: Any) -> Any:
            return ca.SX(plant.f(x, u))

        def output(params: Any, x: Any) -> Any:
            return ca.SX(plant.h(x))
    else:
        states, inputs = plant.states, plant.inputs or ["u"]
        if not (isinstance(plant.f, list) and isinstance(plant.h, list) and states):
            raise InputError(
                f"{key}: formulas need lists f and h and the names in states (and inputs)"
            )
        if len(plant.f) != len(states):
            raise ShapeError(
                f"{key}.f: expected {len(states)} formulas (one per state), found {len(plant.f)}"
            )
        if len({*states, *inputs, *names}) < len(states) + len(inputs) + len(names):
            raise InputError(f"{key}: a name is used twice among states, inputs and parameters")
        if not all(isinstance(text, str) for text in [*plant.f, *plant.h]) or not plant.h:
            raise InputError(
                f"{key}: every entry of f and h must be a formula in quotes, and h must not be empty"
            )
        n, m = len(states), len(inputs)

        def scope(params: Any, x: Any) -> dict[str, Any]:
            return dict(
                zip([*states, *names], [*ca.vertsplit(x), *ca.vertsplit(params)], strict=True)
            )

        def move(params: Any, x: Any, u: Any) -> Any:
            bound = scope(params, x) | dict(zip(inputs, ca.vertsplit(u), strict=True))
            return ca.vertcat(
                *(
                    expression.evaluate(f"{key}.f[{i}]", text, bound)
                    for i, text in enumerate(plant.f)
                )
            )

        def output(params: Any, x: Any) -> Any:
            bound = scope(params, x)
            return ca.vertcat(
                *(
                    expression.evaluate(f"{key}.h[{i}]", text, bound)
                    for i, text in enumerate(plant.h)
                )
            )

    params = np.array(
        [scalar(f"{key}.parameters.{name}", plant.parameters[name]) for name in names]
    )
    x_eq = (
        np.zeros(n) if plant.x_eq is None else vector(f"{key}.x_eq", plant.x_eq, n, "one per state")
    )
    u_eq = (
        np.zeros(m) if plant.u_eq is None else vector(f"{key}.u_eq", plant.u_eq, m, "one per input")
    )
    linear = linearise(key, move, output, params, x_eq, u_eq)
    return System(params, move, output, linear, nonlinear=True, names=tuple(names))
