"""The moving joints of a tree and the bodies between them, in frames that keep the expressions of their dynamics short."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.plants.robots.urdf_file import Body, Joint, Robot
from undeadzone.support.arrays import Floats

ZERO, ONE = (
    1e-11,
    1e-15,
)  # entries this close to 0 (cos(pi/2) of a file's digits), or to 1 and -1, become it: each would cost products in every step


class Frames(NamedTuple):
    """The moving joints at angle 0, all in the base's coordinates: nothing but their own angles turns one against the next.

    axes, origins, anchors (N x 3): the anchor is the point of a joint's axis that is nearest to the anchor before, for shorter
    expressions; bodies: what moves with each joint up to the next; tip (3), turn (3 x 3): of the tip.
    """

    axes: Floats
    origins: Floats
    anchors: Floats
    bodies: list[Body]
    tip: Floats
    turn: Floats


def straightened(robot: Robot, moving: list[Joint], tip: str) -> Frames:
    """The frames of the moving joints, from base to tip, with all other joints fixed at 0."""
    poses = {link: _pose(robot.way(link)) for link in robot.links}
    axes = np.array([exact(poses[joint.child][1] @ joint.axis) for joint in moving])
    origins = np.array([poses[joint.child][0] for joint in moving])
    anchors, anchor = [], np.zeros(3)
    for joint, axis, origin in zip(moving, axes, origins, strict=True):
        if joint.kind != "prismatic":
            anchor = origin - axis * (axis @ (origin - anchor))
        anchors.append(anchor)
    groups: dict[str, list[Body]] = {joint.name: [] for joint in moving}
    for link, body in robot.links.items():
        place, turn = poses[link]
        before = [joint.name for joint in robot.way(link) if joint.name in groups]
        if before:
            groups[before[-1]].append(
                Body(body.mass, place + turn @ body.centre, turn @ body.inertia @ turn.T)
            )
    return Frames(
        axes, origins, np.array(anchors), [_joined(group) for group in groups.values()], *poses[tip]
    )


def _pose(way: list[Joint]) -> tuple[Floats, Floats]:
    """Place and turn in the base's coordinates after these joints, at angle 0."""
    place: Floats = np.zeros(3)
    turn: Floats = np.eye(3)
    for joint in way:
        place, turn = place + turn @ joint.place, exact(turn @ joint.turn)
    return place, turn


def exact(values: Floats) -> Floats:
    """The values, those next to 0, 1 or -1 replaced by it."""
    near = np.clip(np.round(values), -1, 1)
    return np.where(np.abs(values - near) < np.where(near == 0, ZERO, ONE), near, values) + 0.0


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
