"""Arms from URDF files: the serial chain of a file in frames that make its dynamics short, which adam-robotics computes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.plants.robots.arm import Chain, Numbers
from undeadzone.plants.robots.frames import Frames, exact, straightened
from undeadzone.plants.robots.urdf_file import MOVABLE, Joint, Robot, read, suggest
from undeadzone.support.arrays import Array, Floats, vector


def chain(
    path: str | os.PathLike[str],
    joints: Sequence[str] | None = None,
    tip: str | None = None,
    gravity: Array = (0.0, 0.0, -9.81),
) -> Chain:
    """The serial arm in a URDF file, on a fixed base.

    joints: names of the N that move, from base to tip (default: all revolute, continuous and prismatic ones on the way); all others of
    the file are fixed at 0. tip: a link (default: the one in which the chain ends). gravity (3) [m/s^2] in the base's coordinates.
    Parameters [kg]: m1, ... mN: mass of what moves with a joint up to the next, its inertia in proportion; payload: a point at the tip.
    The dynamics are those of adam-robotics (composite rigid bodies, recursive Newton-Euler: Featherstone 2008), which
    pip install 'undeadzone[robots]' brings.

    Raises FileError (the file, or what it says), InputError (joints, tip, gravity; adam-robotics is missing).
    """
    g = vector("plant.arm.gravity", gravity, 3, "x, y, z")
    robot = read(Path(path))
    moving, tip = _selected(robot, joints, tip)
    frames = straightened(robot, moving, tip)
    for joint, body in zip(moving, frames.bodies, strict=True):
        if body.mass == 0:
            advice = (
                f"give it an <inertial>, or leave {joint.name} out of plant.arm.joints (fixed at 0)"
            )
            raise FileError(
                f"plant.arm.path: {path}: link {joint.child} moves but has no mass; {advice}"
            )
    parameters = {f"m{i + 1}": body.mass for i, body in enumerate(frames.bodies)} | {"payload": 0.0}
    mass, bias, points, turn = _functions(moving, frames, g)

    def masses(numbers: Numbers) -> Any:
        return ca.vertcat(*(numbers[name] for name in parameters))

    return Chain(
        tuple(joint.name for joint in moving),
        parameters,
        lambda numbers, q: mass(masses(numbers), q),
        lambda numbers, q, v: bias(masses(numbers), q, v),
        lambda numbers, q: points(q),
        lambda numbers, q: turn(q),
        lambda numbers: ca.DM(g),
        (0, 1, 2),
        np.array([joint.limits for joint in moving]),
        np.array([joint.effort for joint in moving]),
        np.array([joint.velocity for joint in moving]),
        np.array([joint.friction for joint in moving]).T,
    )


def _selected(
    robot: Robot, joints: Sequence[str] | None, tip: str | None
) -> tuple[list[Joint], str]:
    """The moving joints from base to tip, and the tip."""
    known = {joint.name: joint for joint in robot.joints}
    movable = [joint.name for joint in robot.joints if joint.kind in MOVABLE]
    for i, name in enumerate(joints or ()):
        if name not in movable:
            raise InputError(
                f"plant.arm.joints[{i}]: {'a fixed joint' if name in known else 'no joint'} {name!r}; {suggest(name, movable)}"
            )
    if tip is not None and tip not in robot.links:
        raise InputError(f"plant.arm.tip: no link {tip!r}; {suggest(tip, robot.links)}")
    if tip is None:
        tip = _end(robot, movable if joints is None else joints)
    way = [joint.name for joint in robot.way(tip)]
    serial = [name for name in way if name in movable and (joints is None or name in joints)]
    if not serial:
        raise InputError(
            f"plant.arm: no joint moves between the base and {tip!r}; movable joints: {', '.join(movable) or 'none'}"
        )
    if joints is not None and serial != list(joints):
        wrong = next((i for i, name in enumerate(joints) if name not in way), None)
        if wrong is not None:
            why = "the arm must be a serial chain; leave it out (it is fixed at 0)"
            raise InputError(
                f"plant.arm.joints[{wrong}]: {joints[wrong]!r} is not between the base and the tip {tip!r}: {why}"
            )
        raise InputError(
            f"plant.arm.joints: must name each joint once, from base to tip: {', '.join(serial)}"
        )
    for joint in robot.joints:
        if joint.mimics is not None and (joint.name in serial or joint.mimics in serial):
            raise InputError(
                f"plant.arm.joints: {joint.name!r} mimics {joint.mimics!r}, and coupled joints are not supported; leave both out (they are fixed at 0)"
            )
    return [known[name] for name in serial], tip


def _end(robot: Robot, moved: Sequence[str]) -> str:
    """The one link without children to which all of these joints lead."""
    parents = {joint.parent for joint in robot.joints}
    ends = [
        link
        for link in robot.links
        if link not in parents and set(moved) <= {joint.name for joint in robot.way(link)}
    ]
    if not ends:
        raise InputError(
            "plant.arm.tip: the movable joints branch: the arm must be a serial chain; name the link in which it ends (joints elsewhere are fixed at 0)"
        )
    if len(ends) > 1:
        raise InputError(f"plant.arm.tip: the arm ends in {', '.join(ends)}: name one of them")
    return ends[0]


def _functions(
    moving: list[Joint], frames: Frames, gravity: Floats
) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
    """M(masses, q), h(masses, q, v), points(q) and turn(q), by adam."""
    N = len(moving)
    masses, q, v = (ca.SX.sym(name, size) for name, size in (("m", N + 1), ("q", N), ("v", N)))
    adam = _adam(moving, frames, masses)
    H = ca.SX(np.eye(4))

    def place(frame: str) -> Any:
        return adam.forward_kinematics(frame, H, q).array

    def function(name: str, inputs: list[ca.SX], value: Any) -> ca.Function:
        return ca.Function(name, inputs, [ca.densify(value)], {"cse": True})

    h = adam.rnea(H, q, ca.SX(6, 1), v, ca.SX(np.r_[gravity, 0, 0, 0])).array
    points = [
        ca.SX(1, 3),
        *(place(f"origin {i}")[:3, 3].T for i in range(N)),
        place("tip")[:3, 3].T,
    ]
    return (
        function("mass", [masses, q], adam.crba(H, q)[0].array[6:, 6:]),
        function("bias", [masses, q, v], h[6:]),
        function("points", [q], ca.vertcat(*points)),
        function("turn", [q], place("tip")[:3, :3] @ ca.SX(frames.turn)),
    )


def _adam(moving: list[Joint], frames: Frames, masses: ca.SX) -> Any:
    """adam's algorithms for the straightened chain. Raises InputError where adam-robotics is not installed."""
    try:
        from adam.casadi.casadi_like import SpatialMath
        from adam.core import RBDAlgorithms
        from adam.model import Model, StdJoint, StdLink, Tree
        from urdf_parser_py import urdf
    except ModuleNotFoundError:
        raise InputError(
            "plant.arm.kind: a URDF needs adam-robotics: pip install 'undeadzone[robots]'"
        ) from None
    space, level = SpatialMath(), [0.0, 0.0, 0.0]

    def link(name: str, inertial: Any = None) -> Any:
        return StdLink(urdf.Link(name, inertial=inertial), space)

    def joint(
        name: str,
        kind: str,
        parent: str,
        child: str,
        place: Floats,
        axis: Sequence[float] = (1.0, 0.0, 0.0),
        index: int | None = None,
    ) -> Any:
        made = StdJoint(
            urdf.Joint(
                name, parent, child, kind, list(axis), urdf.Pose(exact(place).tolist(), level)
            ),
            space,
            index,
        )
        if kind == "prismatic":  # adam 0.5.0 gives these 12 rows for 6
            made.motion_subspace = lambda: space.asarray([*axis, 0.0, 0.0, 0.0])
        return made

    links, marks, joints = [link("base")], [], []
    before, parent = np.zeros(3), "base"
    for i, (anchor, body) in enumerate(zip(frames.anchors, frames.bodies, strict=True)):
        inertia = urdf.Inertia(
            *(masses[i] / body.mass * entry for entry in body.inertia[np.triu_indices(3)])
        )
        links.append(
            link(
                f"link {i}",
                urdf.Inertial(
                    masses[i], inertia, urdf.Pose(exact(body.centre - anchor).tolist(), level)
                ),
            )
        )
        joints.append(
            joint(
                f"joint {i}",
                moving[i].kind,
                parent,
                f"link {i}",
                anchor - before,
                frames.axes[i].tolist(),
                i,
            )
        )
        marks.append(link(f"origin {i}"))
        joints.append(
            joint(f"to origin {i}", "fixed", f"link {i}", f"origin {i}", frames.origins[i] - anchor)
        )
        before, parent = anchor, f"link {i}"
    links.append(link("tip", urdf.Inertial(masses[-1], urdf.Inertia(), urdf.Pose(level, level))))
    joints.append(joint("to tip", "fixed", parent, "tip", frames.tip - before))
    tables = ({part.name: part for part in parts} for parts in (links, marks, joints))
    return RBDAlgorithms(
        Model(
            "arm",
            *tables,
            Tree.build_tree(links, joints),
            len(moving),
            [f"joint {i}" for i in range(len(moving))],
        ),
        space,
    )
