"""From `plant.arm` to a plant: states x = [q; v], inputs the joints' torques, outputs their positions or velocities."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from undeadzone.errors import InputError, ShapeError
from undeadzone.plants.options import Plant
from undeadzone.plants.robots import elastic, planar
from undeadzone.plants.robots.arm import Arm, Chain, acceleration, arm, numbers, torque
from undeadzone.plants.robots.options import URDF, ArmOptions, ElasticJoint, OneLink, Rigid
from undeadzone.plants.system import Flat, System, linearise
from undeadzone.support.arrays import Floats, array, positive, scalar, vector


def robot(plant: Plant, given: ArmOptions, key: str) -> System:
    """The continuous-time plant of an arm. Raises InputError, ShapeError, FileError that name the key."""
    if isinstance(given, ElasticJoint):
        return elastic.elastic(plant, given, key)
    chain = _limited(given, _chain(given, plant, key), key)
    body = arm(chain, scalar(f"{key}.arm.rest", given.rest, above=0.0))
    params = numbers(body.names, body.values, plant.parameters, key)
    _require_mass(body, params, key)
    N = body.size
    offset = vector(f"{key}.arm.reference", given.reference, N, "one per joint")
    hold = _stops(given, chain, key)

    def move(p: Any, x: Any, u: Any) -> Any:
        q, v = x[:N], x[N:]
        return ca.vertcat(v, acceleration(body, p, q, v, u + hold(q, v)))

    def output(p: Any, x: Any) -> Any:
        return x[:N] - offset if given.measured == "position" else x[N:]

    q0 = (
        np.zeros(N)
        if plant.x0 is None
        else vector(f"{key}.x0", plant.x0, 2 * N, "the angle of each joint, then its speed")[:N]
    )
    x_eq = (
        np.append(q0, np.zeros(N))
        if plant.x_eq is None
        else vector(f"{key}.x_eq", plant.x_eq, 2 * N, "one per state")
    )
    gravity = np.asarray(body.bias(params, x_eq[:N], np.zeros(N))).ravel()
    u_eq = gravity if plant.u_eq is None else vector(f"{key}.u_eq", plant.u_eq, N, "one per input")
    linear = linearise(key, move, output, params, x_eq, u_eq)
    return System(
        params,
        move,
        output,
        linear,
        nonlinear=True,
        arm=body,
        flat=flat(body),
        limit=chain.torque,
        names=body.names,
    )


def flat(body: Arm) -> Flat:
    """The joints of a rigid arm as flat coordinates: with two derivatives they say state and torque."""

    def solve(p: Any, path: Any) -> tuple[Any, Any]:
        q, v, a = ca.horzsplit(path)
        return ca.vertcat(q, v), torque(body, p, q, v, a)

    return Flat(2, solve)


def _chain(given: Rigid, plant: Plant, key: str) -> Chain:
    if isinstance(given, URDF):
        from undeadzone.plants.robots import urdf

        return urdf.chain(given.path, given.joints, given.tip, given.gravity)
    chain = planar.one_link() if isinstance(given, OneLink) else planar.two_link()
    planar.check(
        {name: plant.parameters.get(name, value) for name, value in chain.parameters.items()}, key
    )
    return chain


def _limited(given: Rigid, chain: Chain, key: str) -> Chain:
    """The chain with the limits that the scenario gives in place of its own."""
    N = len(chain.joints)
    if given.torque_max is not None:
        chain = chain._replace(
            torque=positive(f"{key}.arm.torque_max", given.torque_max, N, "one per joint")
        )
    if given.limits is not None:
        limits = array(f"{key}.arm.limits", given.limits)
        if limits.shape not in ((2,), (N, 2)):
            raise ShapeError(
                f"{key}.arm.limits: expected [lo, hi], or one per joint ({N} x 2), found {' x '.join(map(str, limits.shape)) or 'one number'}"
            )
        if (limits[..., 0] >= limits[..., 1]).any():
            raise InputError(
                f"{key}.arm.limits: a range [lo, hi] must have lo < hi, found {limits.tolist()}"
            )
        chain = chain._replace(limits=np.broadcast_to(limits, (N, 2)))
    return chain


def _stops(given: Rigid, chain: Chain, key: str) -> Any:
    """The torque (N) of the mechanical stops, a function of q and v."""
    if given.stops is None:
        return lambda q, v: 0.0
    stiffness, damping = (
        scalar(f"{key}.arm.stops[{i}]", value, least=0.0) for i, value in enumerate(given.stops)
    )
    if not np.isfinite(chain.limits).any():
        raise InputError(
            f"{key}.arm.stops: they stand where the joints' limits are, and these have none; give {key}.arm.limits"
        )
    low, high = (np.clip(side, -1e300, 1e300) for side in chain.limits.T)

    def hold(q: Any, v: Any) -> Any:
        beyond = ca.fmax(q - high, 0.0) + ca.fmin(q - low, 0.0)
        return -stiffness * beyond - damping * v * (beyond != 0)

    return hold


def _require_mass(body: Arm, params: Floats, key: str) -> None:
    """Raise InputError where the mass matrix is not positive definite in some random postures."""
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (8, body.size)):
        values = np.linalg.eigvalsh(np.asarray(body.mass(params, q)))
        if not values[0] > 1e-12 * values[-1]:
            found = f"eigenvalues {values[0]:.3g} to {values[-1]:.3g}"
            raise InputError(
                f"{key}.parameters: the arm's mass matrix is singular or negative ({found}): give every link mass and inertia"
            )
