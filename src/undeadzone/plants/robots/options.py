"""Arms as a scenario names them: `plant.arm`."""

from __future__ import annotations

from typing import Literal

import msgspec

from undeadzone.support.arrays import Array


class Rigid(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every rigid arm may say.

    measured: the joints' position q less `reference` (at which a sensor reads 0; one or one per joint), or their velocity; torque_max: one or one per joint
    [N m]; limits: [lo, hi] of each joint (N x 2), which a path must keep; stops: stiffness [N m/rad] and damping [N m s/rad] of mechanical stops
    there (default: none); rest: speed [rad/s] below which Coulomb friction f v / sqrt(v^2 + rest^2) fades. Its numbers stand in `plant.parameters`.
    """

    measured: Literal["position", "velocity"] = "position"
    reference: Array = 0.0
    torque_max: Array | None = None
    limits: Array | None = None
    stops: tuple[float, float] | None = None
    rest: float = 0.05


class OneLink(
    Rigid, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="one_link"
):
    """One link in a plane; q from the x axis, gravity along -y (g = 0: a horizontal table)."""


class TwoLink(
    Rigid, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="two_link"
):
    """Two links in a plane; q1 from the x axis, q2 from the first link, gravity along -y (g = 0: a horizontal table)."""


class URDF(
    Rigid, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="kind", tag="urdf"
):
    """A serial arm from a URDF file (path relative to the scenario's); needs the extra `robots`.

    joints: those that move (default: all from the base to `tip`; the others stay at 0); tip: a link (default: the last one);
    gravity [m/s^2] in base coordinates.
    """

    path: str
    joints: list[str] | None = None
    tip: str | None = None
    gravity: Array = (0.0, 0.0, -9.81)


class ElasticJoint(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    tag_field="kind",
    tag="elastic_joint",
):
    """A motor that moves a link through a spring, one of them measured (Spong 1987): its angle less `reference` [rad].

    torque_max [N m] of the motor; rest: speed [rad/s] below which Coulomb friction f v / sqrt(v^2 + rest^2) fades.
    """

    measured: Literal["motor", "link"] = "motor"
    reference: float = 0.0
    torque_max: float | None = None
    rest: float = 0.05


ArmOptions = OneLink | TwoLink | URDF | ElasticJoint
