"""An elastic joint: a motor moves a link through a spring (Spong 1987).

A sensor sees one of the two.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from undeadzone.plants.options import Plant
from undeadzone.plants.robots import planar
from undeadzone.plants.robots.arm import Arm, Chain, Numbers, acceleration, arm, numbers, torque
from undeadzone.plants.robots.options import ElasticJoint
from undeadzone.plants.system import Flat, System, linearise
from undeadzone.support.arrays import Floats, scalar, vector


def joint() -> Chain:
    """Motor and link as a chain of two angles [motor; link], both from the x axis.

    The motor's inertia J, a spring of stiffness k, and `one_link`. Parameters: those of the link, J
    motor inertia [kg m^2] and k [N m/rad]. Friction of the motor (b1, f1) and of the link (b2, f2)
    comes with `arm`. Points and turn are the link's; at [motor; motor] they are those of a motor's
    hand of the same length.
    """
    link = planar.one_link()

    def mass(p: Numbers, q: Any) -> Any:
        return ca.diagcat(p["J"], link.mass(p, q[1]))

    def bias(p: Numbers, q: Any, v: Any) -> Any:
        spring = p["k"] * (q[0] - q[1])
        return ca.vertcat(spring, link.bias(p, q[1], v[1]) - spring)

    return link._replace(
        joints=("motor", "link"),
        parameters=link.parameters | {"J": 0.05, "k": 50.0},
        mass=mass,
        bias=bias,
        points=lambda p, q: link.points(p, q[1]),
        turn=lambda p, q: link.turn(p, q[1]),
        limits=np.repeat(link.limits, 2, axis=0),
        torque=np.repeat(link.torque, 2),
        speed=np.repeat(link.speed, 2),
        friction=np.repeat(link.friction, 2, axis=1),
    )


def elastic(plant: Plant, options: ElasticJoint, key: str = "plant") -> System:
    """The plant of an elastic joint.

    x = [motor angle; link angle; their speeds], u = the motor's torque [N m], z = the angle of
    `options.measured` less `reference` [rad]. Its path coordinate is the link's angle: with no
    damper beside the spring, four derivatives of it give state and torque exactly. It is linearised
    at x_eq, by default where the motor holds the link still at its angle in x0, with u_eq that
    holds it.

    Args:
        plant: the plant in words.
        options: the arm of the plant.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    body = arm(joint(), scalar(f"{key}.arm.rest", options.rest, above=0.0))
    planar.check(planar.changed(body.chain.parameters, plant.parameters), key)
    params = numbers(body.names, body.values, plant.parameters, key)
    offset = scalar(f"{key}.arm.reference", options.reference)
    limit = np.inf
    if options.torque_max is not None:
        limit = scalar(f"{key}.arm.torque_max", options.torque_max, above=0.0)

    def move(p: Any, x: Any, u: Any) -> Any:
        q, v = x[:2], x[2:]
        return ca.vertcat(v, acceleration(body, p, q, v, ca.vertcat(u, 0)))

    def output(p: Any, x: Any) -> Any:
        return x[body.chain.joints.index(options.measured)] - offset

    solve = _inverse(body)
    x_eq, u_eq = _equilibrium(plant, params, solve, key)
    linear = linearise(key, move, output, params, x_eq, u_eq)
    return System(
        params,
        move,
        output,
        linear,
        nonlinear=True,
        arm=body,
        flat=Flat(4, solve),
        limit=np.array([limit]),
        names=body.names,
    )


def _equilibrium(
    plant: Plant, params: Floats, solve: ca.Function, key: str
) -> tuple[Floats, Floats]:
    """(x_eq, u_eq): as given, or where the motor holds the link still at its angle in x0."""
    at = "x0" if plant.x_eq is None else "x_eq"
    state = getattr(plant, at)
    x: Floats = np.zeros(4)
    if state is not None:
        why = "the angles of motor and link, then their speeds"
        x = vector(f"{key}.{at}", state, 4, why)
    at_rest = x[1] * np.eye(1, 5)  # the link's angle, its derivatives 0
    still, hold = (np.asarray(part).ravel() for part in solve(params, at_rest))
    x_eq = x if at == "x_eq" else still
    u_eq = hold if plant.u_eq is None else vector(f"{key}.u_eq", plant.u_eq, 1, "one per input")
    return x_eq, u_eq


def _inverse(body: Arm) -> ca.Function:
    """(params, the link's angle and four derivatives of it (1 x 5)) -> (x, u).

    The link's equation gives the motor's angle, the motor's the torque.
    """
    p, path = ca.SX.sym("p", len(body.names)), ca.SX.sym("path", 1, 5)

    def rate(value: Any) -> Any:
        return ca.jtimes(value, path[:, :-1], path[:, 1:])

    q, v, a = path[0], path[1], path[2]
    spring = torque(body, p, ca.vertcat(q, q), ca.vertcat(v, v), ca.vertcat(a, a))[1]
    motor = q + spring / p[body.names.index("k")]
    x = ca.vertcat(motor, q, rate(motor), v)
    u = torque(body, p, x[:2], x[2:], ca.vertcat(rate(rate(motor)), a))[0]
    return ca.Function("inverse", [p, path], [x, u], {"cse": True})
