"""The moving joints of a tree and the bodies between them, as `Frames`.

The frames are chosen so that the expressions of the dynamics are short. They are then said in the
words of adam-robotics, which computes the dynamics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.plants.robots.urdf_elements import Body, Joint, Robot
from undeadzone.support.arrays import Floats

# Entries this close to 0 (cos(pi/2) of a file's digits), or to 1 and -1, become it: each would cost
# products in every step.
ZERO, ONE = 1e-11, 1e-15
LEVEL = [0.0, 0.0, 0.0]  # no turn


class Frames(NamedTuple):
    """The moving joints at angle 0, all in the base's coordinates.

    Nothing but their own angles turns one against the next.

    Attributes:
        axes: the joints' axes (N x 3).
        origins: the joints' places (N x 3) [m].
        anchors: the point of a joint's axis that is nearest to the anchor before, for shorter
            expressions (N x 3) [m].
        bodies: all that moves with each joint up to the next, as one body (N).
        tip: place of the tip (3) [m].
        turn: rotation matrix of the tip (3 x 3).
    """

    axes: Floats
    origins: Floats
    anchors: Floats
    bodies: list[Body]
    tip: Floats
    turn: Floats


def straightened(robot: Robot, moving: list[Joint], tip: str) -> Frames:
    """The frames of an arm, with all joints that do not move fixed at 0.

    Args:
        robot: the tree of a file.
        moving: the moving joints, from base to tip (N).
        tip: the link in which the arm ends.
    """
    poses = {link: _pose(robot.way(link)) for link in robot.links}
    axes = np.array([exact(poses[joint.child][1] @ joint.axis) for joint in moving])
    origins = np.array([poses[joint.child][0] for joint in moving])
    place, turn = poses[tip]
    return Frames(
        axes,
        origins,
        _anchors(moving, axes, origins),
        _bodies(robot, moving, poses),
        place,
        turn,
    )


def exact(values: Floats) -> Floats:
    """The values, those next to 0, 1 or -1 replaced by it."""
    near = np.clip(np.round(values), -1, 1)
    tolerance = np.where(near == 0, ZERO, ONE)
    return np.where(np.abs(values - near) < tolerance, near, values) + 0.0


def _pose(way: list[Joint]) -> tuple[Floats, Floats]:
    """Place and turn in the base's coordinates after these joints, at angle 0."""
    place: Floats = np.zeros(3)
    turn: Floats = np.eye(3)
    for joint in way:
        place = place + turn @ joint.place
        turn = exact(turn @ joint.turn)
    return place, turn


def _anchors(moving: list[Joint], axes: Floats, origins: Floats) -> Floats:
    """The point of each axis nearest to the anchor before (N x 3); a sliding joint keeps it."""
    anchors, anchor = [], np.zeros(3)
    for joint, axis, origin in zip(moving, axes, origins, strict=True):
        if joint.kind != "prismatic":
            anchor = origin - axis * (axis @ (origin - anchor))
        anchors.append(anchor)
    return np.array(anchors)


def _bodies(
    robot: Robot, moving: list[Joint], poses: dict[str, tuple[Floats, Floats]]
) -> list[Body]:
    """What moves with each joint up to the next, as one body, in the base's coordinates (N)."""
    groups: dict[str, list[Body]] = {joint.name: [] for joint in moving}
    for link, body in robot.links.items():
        place, turn = poses[link]
        before = [joint.name for joint in robot.way(link) if joint.name in groups]
        if before:
            centre = place + turn @ body.centre
            inertia = turn @ body.inertia @ turn.T
            groups[before[-1]].append(Body(body.mass, centre, inertia))
    return [_joined(group) for group in groups.values()]


def _joined(bodies: list[Body]) -> Body:
    """Bodies fixed to each other as one."""
    mass = sum(body.mass for body in bodies)
    centre = sum((body.mass * body.centre for body in bodies), np.zeros(3)) / (mass or 1)
    inertia = np.zeros((3, 3))
    for body in bodies:
        d = body.centre - centre
        inertia += body.inertia + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
    scale = np.abs(inertia).max() or 1
    return Body(mass, centre, scale * exact(inertia / scale))


class _Kit(NamedTuple):
    """The classes of adam-robotics and of urdf_parser_py that links and joints are made of."""

    space: Any  # adam's mathematics on CasADi expressions
    link: Any
    joint: Any
    urdf: Any


def algorithms(moving: list[Joint], frames: Frames, masses: ca.SX) -> Any:
    """adam's algorithms for an arm.

    Its frames are "base", "link i", "origin i" (where joint i stands in the file) and "tip".

    Args:
        moving: the moving joints, from base to tip (N).
        frames: their frames.
        masses: masses of the bodies, then the payload (N + 1) [kg].

    Raises:
        InputError: adam-robotics is not installed.
    """
    try:
        from adam.casadi.casadi_like import SpatialMath
        from adam.core import RBDAlgorithms
        from adam.model import Model, StdJoint, StdLink, Tree
        from urdf_parser_py import urdf
    except ModuleNotFoundError:
        raise InputError(
            "plant.arm.kind: a URDF needs adam-robotics: pip install 'undeadzone[robots]'"
        ) from None
    kit = _Kit(SpatialMath(), StdLink, StdJoint, urdf)
    links, marks, joints = _parts(kit, moving, frames, masses)
    tree = Tree.build_tree(links, joints)
    names = [f"joint {i}" for i in range(len(moving))]
    tables = _by_name(links), _by_name(marks), _by_name(joints)
    return RBDAlgorithms(Model("arm", *tables, tree, len(moving), names), kit.space)


def _by_name(parts: list[Any]) -> dict[str, Any]:
    """Links or joints by their names."""
    return {part.name: part for part in parts}


def _parts(
    kit: _Kit, moving: list[Joint], frames: Frames, masses: ca.SX
) -> tuple[list[Any], list[Any], list[Any]]:
    """Links with mass, massless links at the joints' places, and joints, from base to tip."""
    links, marks, joints = [_link(kit, "base")], [], []
    before, parent = np.zeros(3), "base"  # the anchor and link up to here
    for i, (anchor, body) in enumerate(zip(frames.anchors, frames.bodies, strict=True)):
        here, mark = f"link {i}", f"origin {i}"
        links.append(_link(kit, here, _inertial(kit, body, masses[i], anchor)))
        joints.append(
            _joint(
                kit,
                f"joint {i}",
                moving[i].kind,
                (parent, here),
                anchor - before,
                frames.axes[i].tolist(),
                i,
            )
        )
        marks.append(_link(kit, mark))
        joints.append(_fixed(kit, f"to {mark}", (here, mark), frames.origins[i] - anchor))
        before, parent = anchor, here
    level = kit.urdf.Pose(LEVEL, LEVEL)
    links.append(_link(kit, "tip", kit.urdf.Inertial(masses[-1], kit.urdf.Inertia(), level)))
    joints.append(_fixed(kit, "to tip", (parent, "tip"), frames.tip - before))
    return links, marks, joints


def _link(kit: _Kit, name: str, inertial: Any = None) -> Any:
    """A link, without mass by default."""
    return kit.link(kit.urdf.Link(name, inertial=inertial), kit.space)


def _inertial(kit: _Kit, body: Body, mass: ca.SX, anchor: Floats) -> Any:
    """The mass of a body about an anchor, its inertia in proportion to the mass [kg]."""
    triangle = body.inertia[np.triu_indices(3)]  # xx, xy, xz, yy, yz, zz
    inertia = kit.urdf.Inertia(*[mass / body.mass * entry for entry in triangle])
    pose = kit.urdf.Pose(exact(body.centre - anchor).tolist(), LEVEL)
    return kit.urdf.Inertial(mass, inertia, pose)


def _joint(
    kit: _Kit,
    name: str,
    kind: str,
    ends: tuple[str, str],
    place: Floats,
    axis: Sequence[float],
    index: int | None,
) -> Any:
    """A joint.

    Args:
        kit: the classes that it is made of.
        name: name of the joint.
        kind: revolute, continuous, prismatic or fixed.
        ends: parent and child link.
        place: its place in the parent's coordinates (3) [m].
        axis: axis of motion, a unit vector (3).
        index: number of the joint among those that move.
    """
    parent, child = ends
    pose = kit.urdf.Pose(exact(place).tolist(), LEVEL)
    joint = kit.joint(kit.urdf.Joint(name, parent, child, kind, list(axis), pose), kit.space, index)
    if kind == "prismatic":  # adam 0.5.0 gives these 12 rows for 6
        joint.motion_subspace = lambda: kit.space.asarray([*axis, 0.0, 0.0, 0.0])
    return joint


def _fixed(kit: _Kit, name: str, ends: tuple[str, str], place: Floats) -> Any:
    """A joint that does not move."""
    return _joint(kit, name, "fixed", ends, place, (1.0, 0.0, 0.0), None)
