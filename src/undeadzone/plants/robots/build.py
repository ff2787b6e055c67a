"""From `plant.arm` to a plant.

Its states are x = `[q; v]`, its inputs the joints' torques, its outputs their positions or
velocities. There are arms in the plane x-y with one and two links (Spong, Hutchinson, Vidyasagar:
Robot Modeling and Control, 2006, section 7.4), elastic joints, in which a motor moves a link
through a spring (Spong 1987) and a sensor sees one of the two, and the arms of URDF files.

References:
    M. W. Spong (1987), doi:10.1115/1.3143860
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.limits import require_pairs
from undeadzone.plants.options import URDF, ArmOptions, ElasticJoint, OneLink, Plant, Rigid
from undeadzone.plants.robots.arm import (
    Arm,
    Chain,
    Numbers,
    build_arm,
    change_arm_numbers,
    forward_dynamics,
    inverse_dynamics,
)
from undeadzone.plants.robots.geared import Geared, build_geared_arm
from undeadzone.plants.system import Flat, System, linearise_plant
from undeadzone.util.arrays import (
    Array,
    Floats,
    require_array,
    require_number,
    require_positive,
    require_vector,
)

POSTURES = 8  # random ones, in which the mass matrix is checked
POSITIVE = "mlIJk"  # first letters of masses, lengths, inertias and a spring's stiffness


def build_robot_plant(plant: Plant, options: ArmOptions, key: str) -> System:
    """Return the continuous-time plant of an arm.

    Args:
        plant: the plant in words.
        options: the arm of the plant.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if isinstance(options, ElasticJoint):
        return build_elastic_plant(plant, options, key)
    return _build_rigid(plant, options, key)


def _build_rigid(plant: Plant, options: Rigid, key: str) -> System:
    """Return the continuous-time plant of an arm with rigid joints."""
    chain = _override_limits(options, _build_chain(options, plant, key), key)
    if options.gears is not None:
        return _build_geared(plant, options, chain, key)
    body = build_arm(chain, require_number(f"{key}.arm.rest", options.rest, above=0.0))
    params = change_arm_numbers(body.names, body.values, plant.parameters, key)
    _require_mass(body, params, key)
    N = body.joint_count
    offset = require_vector(f"{key}.arm.reference", options.reference, N, "one per joint")
    hold = _build_stops(options, chain, key)

    def move(p: Any, x: Any, u: Any) -> Any:
        """Return x' (2 N)."""
        q = x[:N]
        v = x[N:]
        return ca.vertcat(v, forward_dynamics(body, p, q, v, u + hold(q, v)))

    def output(p: Any, x: Any) -> Any:
        """Return z: positions about the reference posture, or speeds (N)."""
        return x[:N] - offset if options.measured == "position" else x[N:]

    x_eq = _equilibrium_state(plant, N, key)
    load = np.asarray(body.bias(params, x_eq[:N], np.zeros(N))).ravel()
    u_eq = _equilibrium_input(plant, load, key)
    plain = linearise_plant(key, params, move, output, x_eq, u_eq)
    return plain._replace(
        arm=body, flat=build_flat_joints(body), limit=chain.torque, names=body.names
    )


def _build_geared(plant: Plant, options: Rigid, chain: Chain, key: str) -> System:
    """Return the continuous-time plant of an arm with gears: x = `[theta; q; theta'; q']`, z = q.

    With encoders at motors and links z = `[q; theta]`. It is linearised on the flanks that carry
    the links, locked both ways.
    """
    assert options.gears is not None
    if options.measured == "velocity" or np.any(options.reference):
        word = "reference" if np.any(options.reference) else "measured"
        raise InputError(
            f"{key}.arm.{word}: encoders of an arm with gears read positions, and have no zone "
            "about a posture. Leave it out"
        )
    rest = require_number(f"{key}.arm.rest", options.rest, above=0.0)
    gears = build_geared_arm(chain, options.gears, rest, plant.parameters, key)
    params = gears.values
    N = gears.joint_count
    _require_mass(gears.arm, gears.link_params(params), key)
    hold = _build_stops(options, chain, key)
    at, given = _linearisation_state(plant)
    x_eq = require_geared_start(gears, given, f"{key}.{at}")
    if at == "x0":
        x_eq[2 * N :] = 0.0
    load = np.asarray(gears.holding_torque(params, x_eq[N : 2 * N])).ravel()
    u_eq = _equilibrium_input(plant, load, key)
    carrying = np.where(load < 0, -1.0, 1.0)

    def move(p: Any, x: Any, u: Any, contact: Any = None) -> Any:
        """Return x' (4 N)."""
        load = hold(x[N : 2 * N], x[3 * N :])
        return gears.follow(p).motion(p, x, u, contact, load)[0]

    def locked(p: Any, x: Any, u: Any) -> Any:
        """Return x' (4 N) with the gears on the flanks that carry the load."""
        return move(p, x, u, carrying)

    def links(p: Any, x: Any) -> Any:
        """Return the positions of the links (N)."""
        return x[N : 2 * N]

    def both_sides(p: Any, x: Any) -> Any:
        """Return the positions of the links, then of the motors (2 N)."""
        return ca.vertcat(x[N : 2 * N], x[:N])

    def motors(p: Any, x: Any) -> Any:
        """Return the positions of the motors (N)."""
        return x[:N]

    output = both_sides if gears.measured == "both" else links
    return linearise_plant(key, params, locked, output, x_eq, u_eq)._replace(
        move=move,
        arm=gears.arm,
        flat=_build_flat_links(gears),
        limit=chain.torque,
        names=gears.names,
        gears=gears,
        seen=motors if gears.measured == "motor" else None,
    )


def _build_flat_links(gears: Geared) -> Flat:
    """Return the links as flat coordinates, their motors in the middle of the gaps."""

    def solve(p: Any, path: Any) -> tuple[Any, Any]:
        """Return (x, u) on a path of the links."""
        q, v, a = ca.horzsplit(path)
        tau = gears.link_torque(p, q, v, a)
        u = tau + gears.gear_number(p, "inertia") * a + gears.motor_friction_torque(p, v)
        return ca.vertcat(q - gears.gear_number(p, "centre"), q, v, v), u

    return Flat(2, solve)


def require_geared_start(gears: Geared, x: Array | None, key: str) -> Floats:
    """Return a state `[theta; q; theta'; q']` (4 N) as given, or with links `[q; q']` (2 N) on
    their flanks.

    Args:
        gears: the arm.
        x: the state in a user's words (None: at rest at 0).
        key: of the state in messages.

    Raises:
        InputError, ShapeError: it is not a state of the plant.
    """
    N = gears.joint_count
    if x is not None and np.size(x) == 4 * N:
        return require_vector(key, x, 4 * N).copy()
    why = "the angles of the links, then their speeds, or motors and links, then their speeds"
    q, v = np.split(require_vector(key, np.zeros(2 * N) if x is None else x, 2 * N, why), 2)
    return np.concatenate([np.asarray(gears.motors_at_rest(gears.values, q)).ravel(), q, v, v])


def build_flat_joints(body: Arm) -> Flat:
    """Return the joints of a rigid arm as flat coordinates: two derivatives give state and
    torque.
    """

    def solve(p: Any, path: Any) -> tuple[Any, Any]:
        """Return (x, u) on a path of the joints."""
        q, v, a = ca.horzsplit(path)
        return ca.vertcat(q, v), inverse_dynamics(body, p, q, v, a)

    return Flat(2, solve)


def _linearisation_state(plant: Plant) -> tuple[str, Array | None]:
    """Return (key, value) of the state at which an arm is linearised: x_eq, or else x0."""
    return ("x0", plant.x0) if plant.x_eq is None else ("x_eq", plant.x_eq)


def _equilibrium_input(plant: Plant, load: Floats, key: str) -> Floats:
    """Return u_eq: as given, or the input that holds a load (m). Raises ShapeError."""
    if plant.u_eq is None:
        return load
    return require_vector(f"{key}.u_eq", plant.u_eq, load.size, "one per input")


def _equilibrium_state(plant: Plant, N: int, key: str) -> Floats:
    """Return x_eq (2 N): as given, or at rest in the position of x0.

    Raises ShapeError, also for x0.
    """
    rest = np.zeros(2 * N)
    if plant.x0 is not None:
        why = "the angle of each joint, then its speed"
        rest[:N] = require_vector(f"{key}.x0", plant.x0, 2 * N, why)[:N]
    if plant.x_eq is None:
        return rest
    return require_vector(f"{key}.x_eq", plant.x_eq, 2 * N, "one per state")


def _build_chain(options: Rigid, plant: Plant, key: str) -> Chain:
    """Return the links of a rigid arm."""
    if isinstance(options, URDF):
        from undeadzone.plants.robots import urdf

        return urdf.load_urdf_chain(options.path, options.joints, options.tip, options.gravity)
    chain = build_one_link() if isinstance(options, OneLink) else build_two_link()
    require_arm_parameters(change_parameters(chain.parameters, plant.parameters), key)
    return chain


def _override_limits(options: Rigid, chain: Chain, key: str) -> Chain:
    """Return the chain with the limits that the scenario gives in place of its own."""
    N = len(chain.joints)
    if options.torque_max is not None:
        torque_max = require_positive(
            f"{key}.arm.torque_max", options.torque_max, N, "one per joint"
        )
        chain = chain._replace(torque=torque_max)
    if options.limits is not None:
        where = f"{key}.arm.limits"
        limits = require_pairs(
            where, require_array(where, options.limits), N, "[lo, hi]", "per joint"
        )
        if (limits[..., 0] >= limits[..., 1]).any():
            raise InputError(
                f"{where}: a range [lo, hi] must have lo < hi, found {limits.tolist()}"
            )
        chain = chain._replace(limits=np.broadcast_to(limits, (N, 2)))
    return chain


def _build_stops(options: Rigid, chain: Chain, key: str) -> Callable[[Any, Any], Any]:
    """Return the torque (N) of the mechanical stops, a function of q and v."""
    if options.stops is None:
        return lambda q, v: 0.0
    stiffness, damping = (
        require_number(f"{key}.arm.stops[{i}]", value, least=0.0)
        for i, value in enumerate(options.stops)
    )
    if not np.isfinite(chain.limits).any():
        raise InputError(
            f"{key}.arm.stops: they stand at the joints' limits, and these joints have none. "
            f"Give {key}.arm.limits"
        )
    low, high = (np.clip(side, -1e300, 1e300) for side in chain.limits.T)

    def hold(q: Any, v: Any) -> Any:
        """Return the torque of the stops (N) [N m]."""
        beyond = ca.fmax(q - high, 0.0) + ca.fmin(q - low, 0.0)
        return -stiffness * beyond - damping * v * (beyond != 0)

    return hold


def _require_mass(body: Arm, params: Floats, key: str) -> None:
    """Raise InputError if the mass matrix is not positive definite in some random postures."""
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (POSTURES, body.joint_count)):
        values = np.linalg.eigvalsh(np.asarray(body.mass(params, q)))
        if not values[0] > 1e-12 * values[-1]:
            span = f"eigenvalues {values[0]:.3g} to {values[-1]:.3g}"
            raise InputError(
                f"{key}.parameters: the arm's mass matrix is singular or negative ({span}): "
                "give every link mass and inertia"
            )


def build_one_link() -> Chain:
    """Return one link, with q from the x axis, gravity along -y.

    Parameters: m mass [kg], l length [m], c centre of mass from the joint [m], I inertia about that
        centre
    [kg m^2], g gravity [m/s^2] (0: a horizontal table). Their values are those of a uniform rod, c
    = l / 2 and I = m l^2 / 12. Changing one of them does not change the others.
    """

    def mass(p: Numbers, q: Any) -> Any:
        """Return the inertia about the joint [kg m^2]."""
        return p["I"] + p["m"] * p["c"] ** 2

    def bias(p: Numbers, q: Any, v: Any) -> Any:
        """Return the torque of gravity [N m]."""
        return p["m"] * p["c"] * p["g"] * ca.cos(q)

    return _build_planar_chain(
        {"m": 1.2, "l": 0.5, "c": 0.25, "I": 0.025, "g": 9.81}, ("l",), mass, bias
    )


def build_two_link() -> Chain:
    """Return two links, with q1 from the x axis, q2 from the first link, gravity along -y.

    Parameters, of link i = 1, 2: mi mass [kg], li length [m], ci centre of mass from joint i [m],
    Ii inertia about that centre [kg m^2], g gravity [m/s^2] (0: a horizontal table, on which q1 is
    cyclic). Their values are those of uniform rods, ci = li / 2 and Ii = mi li^2 / 12. Changing one
    of them does not change the others.
    """

    def mass(p: Numbers, q: Any) -> Any:
        """Return the mass matrix (2 x 2) [kg m^2]."""
        cross = p["m2"] * p["l1"] * p["c2"] * ca.cos(q[1])
        outer = p["I2"] + p["m2"] * p["c2"] ** 2
        inner = p["I1"] + p["m1"] * p["c1"] ** 2 + p["m2"] * p["l1"] ** 2
        return ca.blockcat([[inner + outer + 2 * cross, outer + cross], [outer + cross, outer]])

    def bias(p: Numbers, q: Any, v: Any) -> Any:
        """Return the torques of gravity and rotation (2) [N m]."""
        swing = p["m2"] * p["l1"] * p["c2"] * ca.sin(q[1])
        outer = p["m2"] * p["c2"] * p["g"] * ca.cos(q[0] + q[1])
        inner = (p["m1"] * p["c1"] + p["m2"] * p["l1"]) * p["g"] * ca.cos(q[0])
        first = inner + outer - swing * v[1] * (2 * v[0] + v[1])
        return ca.vertcat(first, outer + swing * v[0] ** 2)

    masses = {"m1": 3.0, "m2": 2.0}
    lengths = {"l1": 0.4, "l2": 0.3, "c1": 0.2, "c2": 0.15}
    inertias = {"I1": 0.04, "I2": 0.015}
    numbers = masses | lengths | inertias | {"g": 9.81}
    return _build_planar_chain(numbers, ("l1", "l2"), mass, bias)


def change_parameters(
    parameters: Mapping[str, float], changes: Mapping[str, float]
) -> dict[str, float]:
    """Return the parameters of a chain with changes. Changes of unknown names are ignored."""
    return {name: changes.get(name, value) for name, value in parameters.items()}


def require_arm_parameters(parameters: Mapping[str, float], key: str) -> None:
    """Raise InputError unless all numbers are finite and those of `POSITIVE` positive.

    Those are masses, lengths, inertias and stiffness. Then the mass matrix is positive definite in
    every position.

    Args:
        parameters: numbers by name.
        key: name of the table of `parameters` in messages.
    """
    for name, value in parameters.items():
        require_number(
            f"{key}.parameters.{name}", value, above=0.0 if name[0] in POSITIVE else None
        )


def _build_planar_chain(
    parameters: dict[str, float],
    lengths: tuple[str, ...],
    mass: Callable[[Numbers, Any], Any],
    bias: Callable[[Numbers, Any, Any], Any],
) -> Chain:
    """Return a chain of links in the plane, without limits or friction (lengths: names of link
    lengths).
    """
    N = len(lengths)

    def link_points(p: Numbers, q: Any) -> Any:
        """Return the positions of the joints and of the tip (N + 1 x 3) [m]."""
        angle = ca.cumsum(q)  # of each link from the x axis
        length = ca.vertcat(*[p[name] for name in lengths])
        links = ca.horzcat(length * ca.cos(angle), length * ca.sin(angle), ca.DM.zeros(N))
        return ca.vertcat(ca.DM.zeros(1, 3), ca.cumsum(links, 0))

    return Chain(
        joints=tuple(f"q{i + 1}" for i in range(N)),
        parameters=parameters,
        mass=mass,
        bias=bias,
        points=link_points,
        turn=_last_link_rotation,
        gravity=_planar_gravity,
        plane=(0, 1),
        **Chain.fields_without_limits(N),
    )


def _last_link_rotation(p: Numbers, q: Any) -> Any:
    """Return the rotation matrix (3 x 3) of the last link, whose angle is the sum of the
    joints'.
    """
    angle = ca.sum1(q)
    return ca.blockcat(
        [[ca.cos(angle), -ca.sin(angle), 0], [ca.sin(angle), ca.cos(angle), 0], [0, 0, 1]]
    )


def _planar_gravity(p: Numbers) -> Any:
    """Return gravity along -y (3) [m/s^2]."""
    return ca.vertcat(0, -p["g"], 0)


def build_elastic_chain() -> Chain:
    """Return motor and link as a chain of two angles `[motor; link]`, both from the x axis.

    The motor's inertia J, a spring of stiffness k, and `build_one_link`. Parameters: those of the
    link, J motor inertia [kg m^2] and k [N m/rad]. Friction of the motor (b1, f1) and of the link
    (b2, f2) comes with `arm`. Points and turn are the link's. At
    `[motor; motor]` they are those of a motor's hand of the same length.
    """
    link = build_one_link()

    def mass(p: Numbers, q: Any) -> Any:
        """Return the inertias of motor and link (2 x 2) [kg m^2]."""
        return ca.diagcat(p["J"], link.mass(p, q[1]))

    def bias(p: Numbers, q: Any, v: Any) -> Any:
        """Return the torques of spring and gravity (2) [N m]."""
        spring = p["k"] * (q[0] - q[1])
        return ca.vertcat(spring, link.bias(p, q[1], v[1]) - spring)

    return link._replace(
        joints=("motor", "link"),
        parameters=link.parameters | {"J": 0.05, "k": 50.0},
        mass=mass,
        bias=bias,
        points=lambda p, q: link.points(p, q[1]),
        turn=lambda p, q: link.turn(p, q[1]),
        **Chain.fields_without_limits(2),
    )


def build_elastic_plant(plant: Plant, options: ElasticJoint, key: str) -> System:
    """Return the plant of an elastic joint.

    x = `[motor angle; link angle; their speeds]`, u = the motor's torque [N m], z = the angle of
    `options.measured` less `reference` [rad]. Its path coordinate is the link's angle: with no
    damper beside the spring, four derivatives of it give state and torque exactly. It is linearised
    at x_eq, by default at the state in which the motor holds the link still at its angle in x0,
    with u_eq that holds it.

    Args:
        plant: the plant in words.
        options: the arm of the plant.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    body = build_arm(
        build_elastic_chain(), require_number(f"{key}.arm.rest", options.rest, above=0.0)
    )
    require_arm_parameters(change_parameters(body.chain.parameters, plant.parameters), key)
    params = change_arm_numbers(body.names, body.values, plant.parameters, key)
    offset = require_number(f"{key}.arm.reference", options.reference)
    limit = np.inf
    if options.torque_max is not None:
        limit = require_number(f"{key}.arm.torque_max", options.torque_max, above=0.0)

    def move(p: Any, x: Any, u: Any) -> Any:
        """Return x' (4)."""
        q = x[:2]
        v = x[2:]
        return ca.vertcat(v, forward_dynamics(body, p, q, v, ca.vertcat(u, 0)))

    def output(p: Any, x: Any) -> Any:
        """Return the angle of the motor or of the link about the reference."""
        return x[body.chain.joints.index(options.measured)] - offset

    solve = _build_elastic_inverse(body)
    x_eq, u_eq = _elastic_equilibrium(plant, params, solve, key)
    plain = linearise_plant(key, params, move, output, x_eq, u_eq)
    return plain._replace(arm=body, flat=Flat(4, solve), limit=np.array([limit]), names=body.names)


def _elastic_equilibrium(
    plant: Plant, params: Floats, solve: ca.Function, key: str
) -> tuple[Floats, Floats]:
    """Return (x_eq, u_eq): as given, or with the link held still by the motor at its angle in
    x0.
    """
    (at, given) = _linearisation_state(plant)
    why = "the angles of motor and link, then their speeds"
    x = require_vector(f"{key}.{at}", np.zeros(4) if given is None else given, 4, why)
    at_rest = x[1] * np.eye(1, 5)  # the link's angle, its derivatives 0
    still, hold = (np.asarray(part).ravel() for part in solve(params, at_rest))
    return x if at == "x_eq" else still, _equilibrium_input(plant, hold, key)


def _build_elastic_inverse(body: Arm) -> ca.Function:
    """Return (params, the link's angle and four derivatives of it (1 x 5)) -> (x, u).

    The elastic joint is flat in its link's angle: the link's equation gives the angle of the motor,
    and the motor's equation gives the torque u.
    """
    p = ca.SX.sym("p", len(body.names))
    path = ca.SX.sym("path", 1, 5)

    def time_derivative(value: Any) -> Any:
        """Return the time derivative of a value along the path."""
        return ca.jtimes(value, path[:, :-1], path[:, 1:])

    q = path[0]
    v = path[1]
    a = path[2]
    # With equal angles the spring is relaxed. What the link then needs, k (motor - q) must supply.
    together = inverse_dynamics(body, p, ca.vertcat(q, q), ca.vertcat(v, v), ca.vertcat(a, a))
    motor = q + together[1] / p[body.names.index("k")]
    motor_rate = time_derivative(motor)
    x = ca.vertcat(motor, q, motor_rate, v)
    u = inverse_dynamics(body, p, x[:2], x[2:], ca.vertcat(time_derivative(motor_rate), a))[0]
    return ca.Function("inverse", [p, path], [x, u], {"cse": True})
