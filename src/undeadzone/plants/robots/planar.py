"""Arms in the plane x-y with one and two links.

Source: Spong, Hutchinson, Vidyasagar: Robot Modeling and Control, 2006, section 7.4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.plants.robots.arm import Chain, Numbers
from undeadzone.support.arrays import scalar

POSITIVE = "mlIJk"  # first letters of masses, lengths, inertias and a spring's stiffness


def one_link() -> Chain:
    """One link; q from the x axis, gravity along -y.

    Parameters: m mass [kg], l length [m], c centre of mass from the joint [m], I inertia about that
        centre
    [kg m^2], g gravity [m/s^2] (0: a horizontal table). Their values are those of a uniform rod, c
    = l / 2 and I = m l^2 / 12; changing one of them does not change the others.
    """

    def mass(p: Numbers, q: Any) -> Any:
        return p["I"] + p["m"] * p["c"] ** 2

    def bias(p: Numbers, q: Any, v: Any) -> Any:
        return p["m"] * p["c"] * p["g"] * ca.cos(q)

    return _chain({"m": 1.2, "l": 0.5, "c": 0.25, "I": 0.025, "g": 9.81}, ("l",), mass, bias)


def two_link() -> Chain:
    """Two links; q1 from the x axis, q2 from the first link, gravity along -y.

    Parameters, of link i = 1, 2: mi mass [kg], li length [m], ci centre of mass from joint i [m],
    Ii inertia about that centre [kg m^2]; g gravity [m/s^2] (0: a horizontal table, on which q1 is
    cyclic). Their values are those of uniform rods, ci = li / 2 and Ii = mi li^2 / 12; changing one
    of them does not change the others.
    """

    def mass(p: Numbers, q: Any) -> Any:
        cross = p["m2"] * p["l1"] * p["c2"] * ca.cos(q[1])
        outer = p["I2"] + p["m2"] * p["c2"] ** 2
        inner = p["I1"] + p["m1"] * p["c1"] ** 2 + p["m2"] * p["l1"] ** 2
        return ca.blockcat([[inner + outer + 2 * cross, outer + cross], [outer + cross, outer]])

    def bias(p: Numbers, q: Any, v: Any) -> Any:
        swing = p["m2"] * p["l1"] * p["c2"] * ca.sin(q[1])
        outer = p["m2"] * p["c2"] * p["g"] * ca.cos(q[0] + q[1])
        inner = (p["m1"] * p["c1"] + p["m2"] * p["l1"]) * p["g"] * ca.cos(q[0])
        first = inner + outer - swing * v[1] * (2 * v[0] + v[1])
        return ca.vertcat(first, outer + swing * v[0] ** 2)

    masses = {"m1": 3.0, "m2": 2.0}
    lengths = {"l1": 0.4, "l2": 0.3, "c1": 0.2, "c2": 0.15}
    inertias = {"I1": 0.04, "I2": 0.015}
    numbers = masses | lengths | inertias | {"g": 9.81}
    return _chain(numbers, ("l1", "l2"), mass, bias)


def changed(parameters: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """The parameters of a chain, with the changes to them; changes of other names are left out."""
    return {name: changes.get(name, value) for name, value in parameters.items()}


def check(parameters: Mapping[str, float], key: str = "plant") -> None:
    """Raise InputError unless all numbers are finite and those of `POSITIVE` positive.

    Those are masses, lengths, inertias and stiffness. Then the mass matrix is positive definite in
    every position.

    Args:
        parameters: numbers by name.
        key: name of the table of `parameters` in messages.
    """
    for name, value in parameters.items():
        scalar(f"{key}.parameters.{name}", value, above=0.0 if name[0] in POSITIVE else None)


def _chain(
    parameters: dict[str, float],
    lengths: tuple[str, ...],
    mass: Callable[[Numbers, Any], Any],
    bias: Callable[[Numbers, Any, Any], Any],
) -> Chain:
    """A chain of links in the plane, without limits or friction; lengths: names of link lengths."""
    N = len(lengths)

    def points(p: Numbers, q: Any) -> Any:
        angle = ca.cumsum(q)  # of each link from the x axis
        length = ca.vertcat(*[p[name] for name in lengths])
        links = ca.horzcat(length * ca.cos(angle), length * ca.sin(angle), ca.DM.zeros(N))
        return ca.vertcat(ca.DM.zeros(1, 3), ca.cumsum(links, 0))

    free = np.full(N, np.inf)
    return Chain(
        joints=tuple(f"q{i + 1}" for i in range(N)),
        parameters=parameters,
        mass=mass,
        bias=bias,
        points=points,
        turn=_turn,
        gravity=_gravity,
        plane=(0, 1),
        limits=np.outer(free, [-1, 1]),
        torque=free,
        speed=free,
        friction=np.zeros((2, N)),
    )


def _turn(p: Numbers, q: Any) -> Any:
    """Rotation matrix (3 x 3) of the last link, whose angle is the sum of the joints'."""
    angle = ca.sum1(q)
    return ca.blockcat(
        [[ca.cos(angle), -ca.sin(angle), 0], [ca.sin(angle), ca.cos(angle), 0], [0, 0, 1]]
    )


def _gravity(p: Numbers) -> Any:
    """Gravity along -y (3) [m/s^2]."""
    return ca.vertcat(0, -p["g"], 0)
