"""From `plant.arm` to a plant.

Its states are x = [q; v], its inputs the joints' torques, its outputs their positions or
velocities.
"""

from __future__ import annotations

from collections.abc import Callable
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

POSTURES = 8  # random ones, in which the mass matrix is checked


def robot(plant: Plant, options: ArmOptions, key: str) -> System:
    """The continuous-time plant of an arm.

    Args:
        plant: the plant in words.
        options: the arm of the plant.
        key: name of the plant in messages.

    Raises:
        InputError: or a subclass, that names the key.
    """
    if isinstance(options, ElasticJoint):
        return elastic.elastic(plant, options, key)
    return _rigid(plant, options, key)


def _rigid(plant: Plant, options: Rigid, key: str) -> System:
    """The continuous-time plant of an arm with rigid joints."""
    chain = _limited(options, _chain(options, plant, key), key)
    body = arm(chain, scalar(f"{key}.arm.rest", options.rest, above=0.0))
    params = numbers(body.names, body.values, plant.parameters, key)
    _require_mass(body, params, key)
    N = body.size
    offset = vector(f"{key}.arm.reference", options.reference, N, "one per joint")
    hold = _stops(options, chain, key)

    def move(p: Any, x: Any, u: Any) -> Any:
        q, v = x[:N], x[N:]
        return ca.vertcat(v, acceleration(body, p, q, v, u + hold(q, v)))

    def output(p: Any, x: Any) -> Any:
        return x[:N] - offset if options.measured == "position" else x[N:]

    x_eq = _equilibrium(plant, N, key)
    if plant.u_eq is None:
        u_eq = np.asarray(body.bias(params, x_eq[:N], np.zeros(N))).ravel()  # against gravity
    else:
        u_eq = vector(f"{key}.u_eq", plant.u_eq, N, "one per input")
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
    """The joints of a rigid arm as flat coordinates: two derivatives give state and torque."""

    def solve(p: Any, path: Any) -> tuple[Any, Any]:
        q, v, a = ca.horzsplit(path)
        return ca.vertcat(q, v), torque(body, p, q, v, a)

    return Flat(2, solve)


def _equilibrium(plant: Plant, N: int, key: str) -> Floats:
    """x_eq (2 N): as given, or at rest in the position of x0. Raises ShapeError, also for x0."""
    rest = np.zeros(2 * N)
    if plant.x0 is not None:
        why = "the angle of each joint, then its speed"
        rest[:N] = vector(f"{key}.x0", plant.x0, 2 * N, why)[:N]
    if plant.x_eq is None:
        return rest
    return vector(f"{key}.x_eq", plant.x_eq, 2 * N, "one per state")


def _chain(options: Rigid, plant: Plant, key: str) -> Chain:
    """The links of a rigid arm."""
    if isinstance(options, URDF):
        from undeadzone.plants.robots import urdf

        return urdf.chain(options.path, options.joints, options.tip, options.gravity)
    chain = planar.one_link() if isinstance(options, OneLink) else planar.two_link()
    planar.check(planar.changed(chain.parameters, plant.parameters), key)
    return chain


def _limited(options: Rigid, chain: Chain, key: str) -> Chain:
    """The chain with the limits that the scenario gives in place of its own."""
    N = len(chain.joints)
    if options.torque_max is not None:
        torque_max = positive(f"{key}.arm.torque_max", options.torque_max, N, "one per joint")
        chain = chain._replace(torque=torque_max)
    if options.limits is not None:
        limits = array(f"{key}.arm.limits", options.limits)
        if limits.shape not in ((2,), (N, 2)):
            shape = " x ".join(map(str, limits.shape)) or "one number"
            raise ShapeError(
                f"{key}.arm.limits: expected [lo, hi], or one per joint ({N} x 2), found {shape}"
            )
        if (limits[..., 0] >= limits[..., 1]).any():
            raise InputError(
                f"{key}.arm.limits: a range [lo, hi] must have lo < hi, found {limits.tolist()}"
            )
        chain = chain._replace(limits=np.broadcast_to(limits, (N, 2)))
    return chain


def _no_stops(q: Any, v: Any) -> Any:
    """The torque of stops that are not there."""
    return 0.0


def _stops(options: Rigid, chain: Chain, key: str) -> Callable[[Any, Any], Any]:
    """The torque (N) of the mechanical stops, a function of q and v."""
    if options.stops is None:
        return _no_stops
    stiffness, damping = (
        scalar(f"{key}.arm.stops[{i}]", value, least=0.0) for i, value in enumerate(options.stops)
    )
    if not np.isfinite(chain.limits).any():
        raise InputError(
            f"{key}.arm.stops: they stand where the joints' limits are, and these have none; "
            f"give {key}.arm.limits"
        )
    low, high = (np.clip(side, -1e300, 1e300) for side in chain.limits.T)

    def hold(q: Any, v: Any) -> Any:
        beyond = ca.fmax(q - high, 0.0) + ca.fmin(q - low, 0.0)
        return -stiffness * beyond - damping * v * (beyond != 0)

    return hold


def _require_mass(body: Arm, params: Floats, key: str) -> None:
    """Raise InputError where the mass matrix is not positive definite in some random postures."""
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (POSTURES, body.size)):
        values = np.linalg.eigvalsh(np.asarray(body.mass(params, q)))
        if not values[0] > 1e-12 * values[-1]:
            span = f"eigenvalues {values[0]:.3g} to {values[-1]:.3g}"
            raise InputError(
                f"{key}.parameters: the arm's mass matrix is singular or negative ({span}): "
                "give every link mass and inertia"
            )
