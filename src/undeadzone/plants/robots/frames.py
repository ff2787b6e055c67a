"""The moving joints of a tree and the bodies between them, as `Frames`.

The frames are chosen so that the expressions of the dynamics are short.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.plants.robots.urdf_elements import Body, Joint
from undeadzone.plants.robots.urdf_file import Robot
from undeadzone.support.arrays import Floats

# Entries this close to 0 (cos(pi/2) of a file's digits), or to 1 and -1, become it: each would cost
# products in every step.
ZERO, ONE = 1e-11, 1e-15


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
