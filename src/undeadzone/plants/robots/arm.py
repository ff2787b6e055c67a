"""Serial arms of rigid links: M(q) a + h(q, v) + friction = torque, with a payload at the tip, as pure functions on CasADi expressions."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats, scalar

Numbers = Mapping[str, Any]  # an arm's parameters, by name


class Chain(NamedTuple):
    """The links alone: N joints, of angles q [rad] or displacements [m].

    joints: their names; parameters: numbers that may differ between plant and model, with their values (with `payload` among them the
    chain carries it itself); mass(numbers, q): M (N x N); bias(numbers, q, v): Coriolis, centrifugal and gravity torques h (N);
    points(numbers, q): base, joints and tip ((K x 3) [m]) in the order of the chain; turn(numbers, q): the tip's rotation matrix
    (3 x 3); gravity(numbers): (3) [m/s^2].
    plane: coordinates in which the tip moves, 0 to 2; limits (N x 2), torque (N), speed (N): what the joints can do, infinite where nothing is said.
    friction: viscous [N m s/rad] and Coulomb [N m] coefficients (2 x N).
    """

    joints: tuple[str, ...]
    parameters: dict[str, float]
    mass: Callable[[Numbers, Any], Any]
    bias: Callable[[Numbers, Any, Any], Any]
    points: Callable[[Numbers, Any], Any]
    turn: Callable[[Numbers, Any], Any]
    gravity: Callable[[Numbers], Any]
    plane: tuple[int, ...]
    limits: Floats
    torque: Floats
    speed: Floats
    friction: Floats


class Arm(NamedTuple):
    """A chain with payload and friction; each function's first argument is the column of its parameters, in the order of `names`.

    names, values: of the parameters: the chain's, payload [kg], b1, b2, ... (viscous), f1, f2, ... (Coulomb friction);
    mass(params, q), bias(params, q, v): payload included, friction not; friction(params, v) (N); points(params, q), turn(params, q): as
    in `Chain`; tip(params, q): its position in the chain's `plane`.
    """

    chain: Chain
    names: tuple[str, ...]
    values: Floats
    mass: ca.Function
    bias: ca.Function
    friction: ca.Function
    points: ca.Function
    turn: ca.Function
    tip: ca.Function

    @property
    def size(self) -> int:
        """Number of joints."""
        return len(self.chain.joints)


def arm(chain: Chain, rest: float = 0.05) -> Arm:
    """The arm of a chain; rest: speed [rad/s] below which Coulomb friction fades, f v / sqrt(v^2 + rest^2)."""
    N = len(chain.joints)
    viscous, coulomb = ([f"{letter}{i + 1}" for i in range(N)] for letter in "bf")
    parameters = (
        chain.parameters
        | {"payload": 0.0}
        | dict(zip([*viscous, *coulomb], chain.friction.ravel(), strict=True))
    )
    params, q, v = (
        ca.SX.sym(name, size) for name, size in (("p", len(parameters)), ("q", N), ("v", N))
    )
    given = dict(zip(parameters, ca.vertsplit(params), strict=True))
    points = chain.points(given, q)
    tip = points[-1, :].T
    load = 0 if "payload" in chain.parameters else given["payload"]
    J = ca.jacobian(tip, q)
    swing = ca.jtimes(ca.jtimes(tip, q, v), q, v)  # the tip's acceleration at constant v
    b, f = (ca.vertcat(*(given[name] for name in group)) for group in (viscous, coulomb))

    def function(name: str, inputs: list[ca.SX], value: ca.SX) -> ca.Function:
        return ca.Function(name, [params, *inputs], [value], {"cse": True})

    return Arm(
        chain,
        tuple(parameters),
        np.array(list(parameters.values()), float),
        function("mass", [q], chain.mass(given, q) + load * J.T @ J),
        function(
            "bias", [q, v], chain.bias(given, q, v) + load * J.T @ (swing - chain.gravity(given))
        ),
        function("friction", [v], b * v + f * v / ca.sqrt(v**2 + rest**2)),
        function("points", [q], points),
        function("turn", [q], chain.turn(given, q)),
        function("tip", [q], tip[list(chain.plane)]),
    )


def acceleration(given: Arm, params: Any, q: Any, v: Any, torque: Any) -> Any:
    """Forward dynamics: the joints' acceleration (N) under a torque (N)."""
    D, L, order = ca.ldl(ca.densify(given.mass(params, q)))
    return ca.ldl_solve(torque - given.bias(params, q, v) - given.friction(params, v), D, L, order)


def torque(given: Arm, params: Any, q: Any, v: Any, a: Any) -> Any:
    """Inverse dynamics: the torque (N) for an acceleration."""
    return given.mass(params, q) @ a + given.bias(params, q, v) + given.friction(params, v)


def evaluate_rows(f: ca.Function, params: Floats, q: Floats) -> Floats:
    """f(params, q) for each row of q (N x joints): N x rows, or N x rows x columns of a matrix."""
    found = np.asarray(f.map(len(q))(np.broadcast_to(params[:, None], (params.size, len(q))), q.T))
    each = found.reshape(f.size1_out(0), len(q), -1).swapaxes(0, 1)
    return each[..., 0] if f.size2_out(0) == 1 else each


def signless(name: str) -> bool:
    """Whether a parameter of an arm has no sign: masses, lengths, inertias, a spring's stiffness, friction."""
    return name == "payload" or re.fullmatch(r"[mlIJkbf]\d*", name) is not None


def numbers(names: tuple[str, ...], values: Floats, given: Mapping[str, float], key: str) -> Floats:
    """The values of named parameters, some of them given otherwise. Raises InputError."""
    for name in given:
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            raise InputError(
                f"{key}.parameters.{name}: unknown; {f'did you mean {near[0]!r}? ' if near else ''}this arm has {', '.join(names)}"
            )
    found = dict(zip(names, values, strict=True)) | {
        name: scalar(f"{key}.parameters.{name}", value) for name, value in given.items()
    }
    for name, value in found.items():
        if value < 0 and signless(name):
            raise InputError(f"{key}.parameters.{name}: must not be negative, found {value:g}")
    return np.array(list(found.values()), float)
