"""Arms as a scenario names them: `plant.arm`."""

from __future__ import annotations

from typing import Literal

import msgspec

from undeadzone.plants.robots.geared import Gears
from undeadzone.support.arrays import Array
from undeadzone.support.toml import Kind


class Rigid(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every rigid arm of N joints may have; its numbers stand in `plant.parameters`.

    Attributes:
        measured: the joints' position q less `reference`, or their velocity.
        reference: position at which a sensor reads 0, one number or one per joint (N) [rad or m].
        torque_max: largest torque, one number or one per joint (N) [N m]; default: of a URDF file
            its efforts, else no limit.
        limits: [lo, hi], or one per joint (N x 2) [rad or m], which a path must keep; default: of a
            URDF file its limits, else none.
        stops: stiffness [N m/rad] and damping [N m s/rad] of mechanical stops at the limits;
            default: there are none.
        rest: speed below which Coulomb friction f v / sqrt(v^2 + rest^2) fades [rad/s].
        gears: with a gap, between motors and links; default: there are none.
    """

    measured: Literal["position", "velocity"] = "position"
    reference: Array = 0.0
    torque_max: Array | None = None
    limits: Array | None = None
    stops: tuple[float, float] | None = None
    rest: float = 0.05
    gears: Gears | None = None


class OneLink(Rigid, frozen=True, kw_only=True, tag_field="kind", tag="one_link"):
    """One link in a plane; q from the x axis, gravity along -y (g = 0: a horizontal table)."""


class TwoLink(Rigid, frozen=True, kw_only=True, tag_field="kind", tag="two_link"):
    """Two links in a plane, gravity along -y (g = 0: a horizontal table).

    q1 is measured from the x axis, q2 from the first link.
    """


class URDF(Rigid, frozen=True, kw_only=True, tag_field="kind", tag="urdf"):
    """A serial arm of N joints from a URDF file; needs the extra `robots`.

    Attributes:
        path: the file, relative to the scenario's.
        joints: names of those that move (N); default: all from the base to `tip`; the others stay
            at 0.
        tip: the link in which the arm ends; default: the last one.
        gravity: acceleration of gravity in base coordinates (3) [m/s^2].
    """

    path: str
    joints: list[str] | None = None
    tip: str | None = None
    gravity: Array = (0.0, 0.0, -9.81)


class ElasticJoint(Kind, frozen=True, kw_only=True, tag="elastic_joint"):
    """A motor that moves a link through a spring, one of them measured (Spong 1987).

    Attributes:
        measured: the part whose angle, less `reference`, is the output.
        reference: angle at which the sensor reads 0 [rad].
        torque_max: largest torque of the motor [N m]; default: no limit.
        rest: speed below which Coulomb friction f v / sqrt(v^2 + rest^2) fades [rad/s].
    """

    measured: Literal["motor", "link"] = "motor"
    reference: float = 0.0
    torque_max: float | None = None
    rest: float = 0.05


ArmOptions = OneLink | TwoLink | URDF | ElasticJoint
