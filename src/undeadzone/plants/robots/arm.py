"""Serial arms of rigid links, with a payload at the tip, as pure functions on CasADi expressions.

Their equation is M(q) a + h(q, v) + friction = torque.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.util.arrays import Floats, require_number
from undeadzone.util.text import suggest_name

Numbers = Mapping[str, Any]  # an arm's parameters, by name
# Those without a sign.
SIGNLESS = r"payload|([mlIJkbf]|half|inertia|friction|viscous|contact|drag|winding)\d*"


class Chain(NamedTuple):
    """Links of an arm without payload and friction:

    N joints, of angles q [rad] or displacements [m].

    Attributes:
        joints: names of the joints (N).
        parameters: numbers that may differ between plant and model, with their values. With
            `payload` among them the chain carries it itself.
        mass: (numbers, q) -> M (N x N).
        bias: (numbers, q, v) -> Coriolis, centrifugal and gravity torques h (N).
        points: (numbers, q) -> base, joints and tip in the order of the chain (K x 3) [m].
        turn: (numbers, q) -> the tip's rotation matrix (3 x 3).
        gravity: (numbers) -> acceleration of gravity (3) [m/s^2].
        plane: coordinates in which the tip moves, 0 to 2.
        limits: positions that the joints can take (N x 2), infinite without a limit.
        torque: largest torque of the joints (N) [N m or N], infinite without a limit.
        speed: largest speed of the joints (N) [rad/s or m/s], infinite without a limit.
        friction: viscous [N m s/rad] and Coulomb [N m] coefficients (2 x N).
        slides: whether some joint slides, so that not all are of one unit.
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
    slides: bool = False

    @staticmethod
    def fields_without_limits(N: int) -> dict[str, Any]:
        """Return the fields of N joints without limits or friction."""
        endless = np.full(N, np.inf)
        bounds = {"limits": np.outer(endless, [-1, 1]), "torque": endless, "speed": endless}
        return {**bounds, "friction": np.zeros((2, N))}


class Arm(NamedTuple):
    """Chain with payload and friction.

    Each function's first argument is the column of the parameters, in the order of `names`.

    Attributes:
        chain: the links.
        names: names of the parameters: the chain's, payload [kg], b1, b2, ... (viscous friction),
            f1, f2, ... (Coulomb friction).
        values: values of the parameters, in the order of names.
        mass: (params, q) -> M with the payload (N x N).
        bias: (params, q, v) -> h with the payload, without friction (N).
        friction: (params, v) -> the torque of friction (N).
        points: (params, q) -> as in `Chain` (K x 3) [m].
        turn: (params, q) -> as in `Chain` (3 x 3).
        tip: (params, q) -> the tip's position in the chain's `plane` [m].
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
    def joint_count(self) -> int:
        """Return the number of joints."""
        return len(self.chain.joints)


def build_arm(chain: Chain, rest: float = 0.05) -> Arm:
    """Return the arm of a chain.

    Args:
        chain: the links.
        rest: speed [rad/s] below which Coulomb friction fades, f v / sqrt(v^2 + rest^2).
    """
    N = len(chain.joints)
    viscous = [f"b{i + 1}" for i in range(N)]
    coulomb = [f"f{i + 1}" for i in range(N)]
    friction = dict(zip([*viscous, *coulomb], chain.friction.ravel(), strict=True))
    parameters = chain.parameters | {"payload": 0.0} | friction
    params = ca.SX.sym("p", len(parameters))
    q = ca.SX.sym("q", N)
    v = ca.SX.sym("v", N)
    numbers = dict(zip(parameters, ca.vertsplit(params), strict=True))
    points = chain.points(numbers, q)
    tip = points[-1, :].T
    load = 0 if "payload" in chain.parameters else numbers["payload"]
    J = ca.jacobian(tip, q)
    swing = ca.jtimes(ca.jtimes(tip, q, v), q, v)  # the tip's acceleration at constant v
    bias = chain.bias(numbers, q, v) + load * J.T @ (swing - chain.gravity(numbers))
    b = _stack_numbers(numbers, viscous)
    f = _stack_numbers(numbers, coulomb)
    return Arm(
        chain,
        tuple(parameters),
        np.array(list(parameters.values()), float),
        _build_shared_function("mass", [params, q], chain.mass(numbers, q) + load * J.T @ J),
        _build_shared_function("bias", [params, q, v], bias),
        _build_shared_function("friction", [params, v], b * v + f * v / ca.sqrt(v**2 + rest**2)),
        _build_shared_function("points", [params, q], points),
        _build_shared_function("turn", [params, q], chain.turn(numbers, q)),
        _build_shared_function("tip", [params, q], tip[list(chain.plane)]),
    )


def _stack_numbers(numbers: Numbers, names: Iterable[str]) -> Any:
    """Return some of the numbers as a CasADi column."""
    return ca.vertcat(*[numbers[name] for name in names])


def _build_shared_function(name: str, inputs: list[ca.SX], value: ca.SX) -> ca.Function:
    """Return a function whose common subexpressions are computed once."""
    return ca.Function(name, inputs, [value], {"cse": True})


def forward_dynamics(body: Arm, params: Any, q: Any, v: Any, torque: Any) -> Any:
    """Return the acceleration of the joints (N) [rad/s^2] under a torque (N)."""
    D, L, order = ca.ldl(ca.densify(body.mass(params, q)))
    return ca.ldl_solve(torque - body.bias(params, q, v) - body.friction(params, v), D, L, order)


def inverse_dynamics(body: Arm, params: Any, q: Any, v: Any, a: Any) -> Any:
    """Return the torque of the joints (N) [N m] for an acceleration (N)."""
    return body.mass(params, q) @ a + body.bias(params, q, v) + body.friction(params, v)


def evaluate_rows(f: ca.Function, params: Floats, q: Floats) -> Floats:
    """Return f(params, q) for each row of q.

    Args:
        f: a function of an `Arm`, of parameters and positions.
        params: the arm's parameters.
        q: positions of the joints (N x joints).

    Returns:
        N x rows of the value, or N x rows x columns if it is a matrix.
    """
    columns = np.broadcast_to(params[:, None], (params.size, len(q)))
    side_by_side = np.asarray(f.map(len(q))(columns, q.T))
    values = side_by_side.reshape(f.size1_out(0), len(q), -1).swapaxes(0, 1)
    return values[..., 0] if f.size2_out(0) == 1 else values


def is_signless(name: str) -> bool:
    """Return whether a parameter of an arm has no sign: masses, lengths, inertias, stiffness,
    friction.
    """
    return re.fullmatch(SIGNLESS, name) is not None


def change_arm_numbers(
    names: tuple[str, ...], values: Floats, changes: Mapping[str, float], key: str
) -> Floats:
    """Return the values of an arm's parameters, some of them changed by name.

    Args:
        names: names of the parameters.
        values: values of the parameters.
        changes: other values, by name.
        key: name of the plant in messages.

    Raises:
        InputError: a name is unknown, or a value cannot be.
    """
    for name in changes:
        if name not in names:
            advice = suggest_name(name, names, "This arm has")
            raise InputError(f"{key}.parameters.{name}: unknown. {advice}")
    parameters = dict(zip(names, values, strict=True))
    for name, value in changes.items():
        parameters[name] = require_number(f"{key}.parameters.{name}", value)
    for name, value in parameters.items():
        if value < 0 and is_signless(name):
            raise InputError(f"{key}.parameters.{name}: must not be negative, found {value:g}")
    return np.array(list(parameters.values()), float)
