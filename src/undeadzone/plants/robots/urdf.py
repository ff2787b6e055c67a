"""Arms from URDF files: the serial chain of a file, whose dynamics adam-robotics computes.

The chain stands in frames that make its dynamics short.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.plants.robots.arm import Chain, Numbers
from undeadzone.plants.robots.urdf_elements import (
    MOVABLE,
    Body,
    Joint,
    Robot,
    read_urdf,
)
from undeadzone.util.arrays import Array, Floats, require_vector
from undeadzone.util.text import suggest_name

# Entries this close to 0 (cos(pi/2) of a file's digits), or to 1 and -1, become it: each would cost
# products in every step.
ZERO = 1e-11
ONE = 1e-15
LEVEL = [0.0, 0.0, 0.0]  # no turn


class Frames(NamedTuple):
    """Moving joints at angle 0, all in the base's coordinates.

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


def straighten_chain(robot: Robot, moving: list[Joint], tip: str) -> Frames:
    """Return the frames of an arm, with all joints that do not move fixed at 0.

    Args:
        robot: the tree of a file.
        moving: the moving joints, from base to tip (N).
        tip: the link in which the arm ends.
    """
    poses = {link: _pose_in_base(robot.joints_to_link(link)) for link in robot.links}
    axes = np.array([snap_to_units(poses[joint.child][1] @ joint.axis) for joint in moving])
    origins = np.array([poses[joint.child][0] for joint in moving])
    anchors = _anchor_points(moving, axes, origins)
    bodies = _collect_bodies(robot, moving, poses)
    return Frames(axes, origins, anchors, bodies, *poses[tip])


def snap_to_units(values: Floats) -> Floats:
    """Return the values, rounded to 0, 1 or -1 if next to it."""
    near = np.clip(np.round(values), -1, 1)
    tolerance = np.where(near == 0, ZERO, ONE)
    return np.where(np.abs(values - near) < tolerance, near, values) + 0.0


def _pose_in_base(way: list[Joint]) -> tuple[Floats, Floats]:
    """Return the place and turn in the base's coordinates after these joints, at angle 0."""
    place: Floats = np.zeros(3)
    turn: Floats = np.eye(3)
    for joint in way:
        place = place + turn @ joint.place
        turn = snap_to_units(turn @ joint.turn)
    return place, turn


def _anchor_points(moving: list[Joint], axes: Floats, origins: Floats) -> Floats:
    """Return the point of each axis nearest to the previous anchor (N x 3), or that of a slider."""
    anchors = []
    anchor = np.zeros(3)
    for joint, axis, origin in zip(moving, axes, origins, strict=True):
        if joint.kind != "prismatic":
            anchor = origin - axis * (axis @ (origin - anchor))
        anchors.append(anchor)
    return np.array(anchors)


def _collect_bodies(
    robot: Robot, moving: list[Joint], poses: dict[str, tuple[Floats, Floats]]
) -> list[Body]:
    """Return the links that move with each joint up to the next, as one body, in the base's
    coordinates (N).
    """
    groups: dict[str, list[Body]] = {joint.name: [] for joint in moving}
    for link, body in robot.links.items():
        place, turn = poses[link]
        before = [joint.name for joint in robot.joints_to_link(link) if joint.name in groups]
        if before:
            centre = place + turn @ body.centre
            inertia = turn @ body.inertia @ turn.T
            groups[before[-1]].append(Body(body.mass, centre, inertia))
    return list(map(_join_bodies, groups.values()))


def _join_bodies(bodies: list[Body]) -> Body:
    """Return the combined body of bodies fixed to each other."""
    mass = sum(body.mass for body in bodies)
    centre = sum((body.mass * body.centre for body in bodies), np.zeros(3)) / (mass or 1)
    inertia = np.zeros((3, 3))
    for body in bodies:
        d = body.centre - centre
        inertia += body.inertia + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
    scale = np.abs(inertia).max() or 1
    return Body(mass, centre, scale * snap_to_units(inertia / scale))


class _Kit(NamedTuple):
    """Classes of adam-robotics and of urdf_parser_py for links and joints."""

    space: Any  # adam's mathematics on CasADi expressions
    link_class: Any
    joint_class: Any
    urdf: Any

    def build_link(self, name: str, inertial: Any = None) -> Any:
        """Return a link, without mass by default."""
        return self.link_class(self.urdf.Link(name, inertial=inertial), self.space)

    def build_inertial(self, body: Body, mass: ca.SX, anchor: Floats) -> Any:
        """Return the mass of a body about an anchor, its inertia in proportion to the mass
        [kg].
        """
        triangle = body.inertia[np.triu_indices(3)]  # xx, xy, xz, yy, yz, zz
        inertia = self.urdf.Inertia(*[mass / body.mass * entry for entry in triangle])
        return self.urdf.Inertial(mass, inertia, self.build_pose(body.centre - anchor))

    def build_joint(
        self,
        name: str,
        ends: tuple[str, str],
        place: Floats,
        kind: str = "fixed",
        axis: Sequence[float] = (1.0, 0.0, 0.0),
        index: int | None = None,
    ) -> Any:
        """Return a joint, fixed by default.

        Args:
            name: name of the joint.
            ends: parent and child link.
            place: its place in the parent's coordinates (3) [m].
            kind: revolute, continuous, prismatic or fixed.
            axis: axis of motion, a unit vector (3).
            index: number of the joint among those that move.
        """
        words = self.urdf.Joint(name, *ends, kind, list(axis), self.build_pose(place))
        joint = self.joint_class(words, self.space, index)
        if kind == "prismatic":  # adam 0.5.0 gives these 12 rows for 6
            joint.motion_subspace = lambda: self.space.asarray([*axis, 0.0, 0.0, 0.0])
        return joint

    def build_pose(self, place: Floats) -> Any:
        """Return a place (3) [m] without a turn."""
        return self.urdf.Pose(snap_to_units(place).tolist(), LEVEL)


def build_adam_algorithms(moving: list[Joint], frames: Frames, masses: ca.SX) -> Any:
    """Return adam's algorithms for an arm.

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
    links, marks, joints = _build_parts(kit, moving, frames, masses)
    tree = Tree.build_tree(links, joints)
    names = [f"joint {i}" for i in range(len(moving))]
    tables = [{part.name: part for part in parts} for parts in (links, marks, joints)]
    return RBDAlgorithms(Model("arm", *tables, tree, len(moving), names), kit.space)


def _build_parts(
    kit: _Kit, moving: list[Joint], frames: Frames, masses: ca.SX
) -> tuple[list[Any], list[Any], list[Any]]:
    """Return links with mass, massless links at the joints' places, and joints, from base to
    tip.
    """
    links = [kit.build_link("base")]
    marks = []
    joints = []
    # the anchor and link up to here
    before = np.zeros(3)
    parent = "base"
    for i, (anchor, body) in enumerate(zip(frames.anchors, frames.bodies, strict=True)):
        here = f"link {i}"
        mark = f"origin {i}"
        links.append(kit.build_link(here, kit.build_inertial(body, masses[i], anchor)))
        turning = moving[i].kind, frames.axes[i].tolist(), i
        joints.append(kit.build_joint(f"joint {i}", (parent, here), anchor - before, *turning))
        marks.append(kit.build_link(mark))
        joints.append(kit.build_joint(f"to {mark}", (here, mark), frames.origins[i] - anchor))
        before = anchor
        parent = here
    payload = kit.urdf.Inertial(masses[-1], kit.urdf.Inertia(), kit.build_pose(np.zeros(3)))
    links.append(kit.build_link("tip", payload))
    joints.append(kit.build_joint("to tip", (parent, "tip"), frames.tip - before))
    return links, marks, joints


def load_urdf_chain(
    path: str | os.PathLike[str],
    joints: Sequence[str] | None = None,
    tip: str | None = None,
    gravity: Array = (0.0, 0.0, -9.81),
) -> Chain:
    """Return the serial arm in a URDF file, on a fixed base.

    Parameters [kg]: m1, ... mN: mass of the links that move with a joint up to the next, its
    inertia in proportion, payload: a point at the tip. The dynamics are those of adam-robotics
    (composite rigid bodies, recursive Newton-Euler: Featherstone 2008), which pip install
    'undeadzone[robots]' brings.

    References:
        R. Featherstone (2008), doi:10.1007/978-1-4899-7560-7

    Args:
        path: the file.
        joints: names of the N joints that move, from base to tip (default: all revolute, continuous
            and prismatic ones on the way). All others of the file are fixed at 0.
        tip: a link (default: the one in which the chain ends).
        gravity: acceleration in the base's coordinates (3) [m/s^2].

    Raises:
        FileError: the file, or its contents.
        InputError: joints, tip, gravity, or adam-robotics is missing.
    """
    g = require_vector("plant.arm.gravity", gravity, 3, "x, y, z")
    robot = read_urdf(Path(path))
    moving, tip = select_joints(robot, joints, tip)
    frames = straighten_chain(robot, moving, tip)
    _require_masses(path, moving, frames)
    parameters = {f"m{i + 1}": body.mass for i, body in enumerate(frames.bodies)} | {"payload": 0.0}
    mass, bias, points, turn = _build_functions(moving, frames, g)

    def masses(numbers: Numbers) -> Any:
        """Return the masses as a CasADi column."""
        return ca.vertcat(*[numbers[name] for name in parameters])

    return Chain(
        joints=tuple(joint.name for joint in moving),
        parameters=parameters,
        mass=lambda numbers, q: mass(masses(numbers), q),
        bias=lambda numbers, q, v: bias(masses(numbers), q, v),
        points=lambda numbers, q: points(q),
        turn=lambda numbers, q: turn(q),
        gravity=lambda numbers: ca.DM(g),
        plane=(0, 1, 2),
        limits=np.array([joint.limits for joint in moving]),
        torque=np.array([joint.effort for joint in moving]),
        speed=np.array([joint.velocity for joint in moving]),
        friction=np.array([joint.friction for joint in moving]).T,
        slides=any(joint.kind == "prismatic" for joint in moving),
    )


def _require_masses(path: str | os.PathLike[str], moving: list[Joint], frames: Frames) -> None:
    """Raise FileError if a moving link has no mass."""
    for joint, body in zip(moving, frames.bodies, strict=True):
        if body.mass == 0:
            raise FileError(
                f"plant.arm.path: {path}: link {joint.child} moves but has no mass. "
                f"Give it an <inertial>, or leave {joint.name} out of plant.arm.joints (fixed at 0)"
            )


def select_joints(
    robot: Robot, joints: Sequence[str] | None, tip: str | None
) -> tuple[list[Joint], str]:
    """Return the moving joints from base to tip, and the tip.

    Args:
        robot: the tree of a file.
        joints, tip: as for `chain`.

    Raises:
        InputError: these joints make no chain.
    """
    known = {joint.name: joint for joint in robot.joints}
    movable = [joint.name for joint in robot.joints if joint.kind in MOVABLE]
    for i, name in enumerate(joints or ()):
        if name not in movable:
            what = "a fixed joint" if name in known else "no joint"
            advice = suggest_name(name, movable, "The file has")
            raise InputError(f"plant.arm.joints[{i}]: {what} {name!r}. {advice}")
    if tip is not None and tip not in robot.links:
        raise InputError(
            f"plant.arm.tip: no link {tip!r}. {suggest_name(tip, robot.links, 'The file has')}"
        )
    moved = movable if joints is None else joints
    if tip is None:
        tip = _find_arm_end(robot, moved, movable)
    way = [joint.name for joint in robot.joints_to_link(tip)]
    serial = [name for name in way if name in movable and name in moved]
    if not serial:
        raise InputError(
            f"plant.arm: no joint moves between the base and {tip!r}. "
            f"Movable joints: {', '.join(movable) or 'none'}"
        )
    if joints is not None:
        _require_joint_order(joints, way, serial, tip)
    _require_uncoupled(robot, serial)
    return [known[name] for name in serial], tip


def _require_joint_order(
    joints: Sequence[str], way: list[str], serial: list[str], tip: str
) -> None:
    """Raise InputError unless the user names the moving joints from base to tip.

    Args:
        joints: names as the user gives them.
        way: names of all joints from base to tip.
        serial: those of `joints` on the way, in its order.
        tip: the link in which the arm ends.
    """
    for i, name in enumerate(joints):
        if name not in way:
            raise InputError(
                f"plant.arm.joints[{i}]: {name!r} is not between the base and the tip {tip!r}: "
                "the arm must be a serial chain. Leave it out (it is fixed at 0)"
            )
    if serial != list(joints):
        raise InputError(
            f"plant.arm.joints: must name each joint once, from base to tip: {', '.join(serial)}"
        )


def _require_uncoupled(robot: Robot, serial: list[str]) -> None:
    """Raise InputError if a moving joint mimics a joint or is mimicked."""
    for joint in robot.joints:
        if joint.mimics is not None and (joint.name in serial or joint.mimics in serial):
            raise InputError(
                f"plant.arm.joints: {joint.name!r} mimics {joint.mimics!r}, and coupled joints are "
                "not supported. Leave both out (they are fixed at 0)"
            )


def _find_arm_end(robot: Robot, moved: Sequence[str], movable: Sequence[str]) -> str:
    """Return the single link without children to which all of these joints lead.

    Of a whole file whose joints branch it is the link at which they do, if no branch has more
    joints than lead there: those of a gripper or of fingers stay at 0. Of joints by name that lead
    to several such links, it is the link at which joints without a name begin.

    Args:
        robot: the tree of links and joints.
        moved: names of the moving joints.
        movable: names of the joints that can move.
    """
    parents = {joint.parent for joint in robot.joints}
    ends = []
    for link in robot.links:
        way = {joint.name for joint in robot.joints_to_link(link)}
        if link not in parents and set(moved) <= way:
            ends.append(link)
    if not ends:
        palm = _find_branching_link(robot, moved)
        deepest = max(_count_joints(robot, joint.child, moved) for joint in robot.joints)
        if moved is movable and deepest <= 2 * _count_joints(robot, palm, moved):
            return palm
        raise InputError(
            f"plant.arm.tip: the movable joints branch at {palm!r}: the arm must be a serial "
            "chain. Name the link in which it ends, such as that one (joints elsewhere are fixed "
            "at 0)"
        )
    if len(ends) > 1:
        palm = _find_branching_link(robot, movable)
        if _count_joints(robot, palm, moved) == len(moved):
            return palm
        raise InputError(f"plant.arm.tip: the arm ends in {', '.join(ends)}: name one of them")
    return ends[0]


def _count_joints(robot: Robot, link: str, moved: Sequence[str]) -> int:
    """Return how many of the joints lead to a link."""
    return sum(joint.name in moved for joint in robot.joints_to_link(link))


def _find_branching_link(robot: Robot, moved: Sequence[str]) -> str:
    """Return the last link that the paths from the base to all moving joints share.

    Args:
        robot: the tree of links and joints.
        moved: names of the moving joints, which do not lie on one path.
    """
    joints = {joint.name: joint for joint in robot.joints}
    paths = [robot.joints_to_link(joints[name].child) for name in moved]
    inner: set[str] = set()  # names of joints that lead to another moving joint
    for path in paths:
        inner.update(joint.name for joint in path[:-1])
    # The paths to the moving joints that lead to no other one, each without that joint.
    outermost = [path[:-1] for path in paths if path[-1].name not in inner]
    link = next(name for name in robot.links if not robot.joints_to_link(name))  # the base
    for at_depth in zip(*outermost, strict=False):
        if len({joint.name for joint in at_depth}) > 1:
            break
        link = at_depth[0].child
    return link


def _build_functions(
    moving: list[Joint], frames: Frames, gravity: Floats
) -> tuple[ca.Function, ...]:
    """Return M(masses, q), h(masses, q, v), points(q) and turn(q) of a `Chain`, by adam."""
    N = len(moving)
    masses = ca.SX.sym("m", N + 1)
    q = ca.SX.sym("q", N)
    v = ca.SX.sym("v", N)
    adam = build_adam_algorithms(moving, frames, masses)
    H = ca.SX(np.eye(4))  # pose of the base

    def pose(frame: str) -> Any:
        """Return the pose of a frame (4 x 4)."""
        return adam.forward_kinematics(frame, H, q).array

    base_twist = ca.SX(6, 1)
    base_gravity = ca.SX(np.r_[gravity, 0, 0, 0])
    h = adam.rnea(H, q, base_twist, v, base_gravity).array  # of the base (6), then of the joints
    M = adam.crba(H, q)[0].array
    origins = [pose(f"origin {i}")[:3, 3].T for i in range(N)]
    tip = pose("tip")
    points = ca.vertcat(ca.SX(1, 3), *origins, tip[:3, 3].T)
    return (
        _build_dense_function("mass", [masses, q], M[6:, 6:]),
        _build_dense_function("bias", [masses, q, v], h[6:]),
        _build_dense_function("points", [q], points),
        _build_dense_function("turn", [q], tip[:3, :3] @ ca.SX(frames.turn)),
    )


def _build_dense_function(name: str, inputs: list[ca.SX], value: Any) -> ca.Function:
    """Return a dense function whose common subexpressions are computed once."""
    return ca.Function(name, inputs, [ca.densify(value)], {"cse": True})
