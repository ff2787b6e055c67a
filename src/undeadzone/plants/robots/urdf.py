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
from undeadzone.plants.robots.frames import Frames, algorithms, straightened
from undeadzone.plants.robots.urdf_elements import MOVABLE, Joint, Robot, read, suggest
from undeadzone.support.arrays import Array, Floats, vector


def chain(
    path: str | os.PathLike[str],
    joints: Sequence[str] | None = None,
    tip: str | None = None,
    gravity: Array = (0.0, 0.0, -9.81),
) -> Chain:
    """The serial arm in a URDF file, on a fixed base.

    Parameters [kg]: m1, ... mN: mass of what moves with a joint up to the next, its inertia in
    proportion; payload: a point at the tip. The dynamics are those of adam-robotics (composite
    rigid bodies, recursive Newton-Euler: Featherstone 2008), which pip install 'undeadzone[robots]'
    brings.

    Args:
        path: the file.
        joints: names of the N joints that move, from base to tip; default: all revolute, continuous
            and prismatic ones on the way. All others of the file are fixed at 0.
        tip: a link; default: the one in which the chain ends.
        gravity: acceleration in the base's coordinates (3) [m/s^2].

    Raises:
        FileError: the file, or its contents.
        InputError: joints, tip, gravity; or adam-robotics is missing.
    """
    g = vector("plant.arm.gravity", gravity, 3, "x, y, z")
    robot = read(Path(path))
    moving, tip = _selected(robot, joints, tip)
    frames = straightened(robot, moving, tip)
    _require_masses(path, moving, frames)
    parameters = {f"m{i + 1}": body.mass for i, body in enumerate(frames.bodies)} | {"payload": 0.0}
    functions = _functions(moving, frames, g)

    def masses(numbers: Numbers) -> Any:
        return ca.vertcat(*[numbers[name] for name in parameters])

    return Chain(
        joints=tuple(joint.name for joint in moving),
        parameters=parameters,
        mass=lambda numbers, q: functions.mass(masses(numbers), q),
        bias=lambda numbers, q, v: functions.bias(masses(numbers), q, v),
        points=lambda numbers, q: functions.points(q),
        turn=lambda numbers, q: functions.turn(q),
        gravity=lambda numbers: ca.DM(g),
        plane=(0, 1, 2),
        limits=np.array([joint.limits for joint in moving]),
        torque=np.array([joint.effort for joint in moving]),
        speed=np.array([joint.velocity for joint in moving]),
        friction=np.array([joint.friction for joint in moving]).T,
        slides=any(joint.kind == "prismatic" for joint in moving),
    )


def _require_masses(path: str | os.PathLike[str], moving: list[Joint], frames: Frames) -> None:
    """Raise FileError where a link moves that has no mass."""
    for joint, body in zip(moving, frames.bodies, strict=True):
        if body.mass == 0:
            raise FileError(
                f"plant.arm.path: {path}: link {joint.child} moves but has no mass; "
                f"give it an <inertial>, or leave {joint.name} out of plant.arm.joints (fixed at 0)"
            )


def _selected(
    robot: Robot, joints: Sequence[str] | None, tip: str | None
) -> tuple[list[Joint], str]:
    """The moving joints from base to tip, and the tip."""
    known = {joint.name: joint for joint in robot.joints}
    movable = [joint.name for joint in robot.joints if joint.kind in MOVABLE]
    for i, name in enumerate(joints or ()):
        if name not in movable:
            what = "a fixed joint" if name in known else "no joint"
            advice = suggest(name, movable)
            raise InputError(f"plant.arm.joints[{i}]: {what} {name!r}; {advice}")
    if tip is not None and tip not in robot.links:
        raise InputError(f"plant.arm.tip: no link {tip!r}; {suggest(tip, robot.links)}")
    moved = movable if joints is None else joints
    if tip is None:
        tip = end(robot, moved)
    way = [joint.name for joint in robot.way(tip)]
    serial = [name for name in way if name in movable and name in moved]
    if not serial:
        raise InputError(
            f"plant.arm: no joint moves between the base and {tip!r}; "
            f"movable joints: {', '.join(movable) or 'none'}"
        )
    if joints is not None:
        _require_order(joints, way, serial, tip)
    _require_uncoupled(robot, serial)
    return [known[name] for name in serial], tip


def _require_order(joints: Sequence[str], way: list[str], serial: list[str], tip: str) -> None:
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
                "the arm must be a serial chain; leave it out (it is fixed at 0)"
            )
    if serial != list(joints):
        raise InputError(
            f"plant.arm.joints: must name each joint once, from base to tip: {', '.join(serial)}"
        )


def _require_uncoupled(robot: Robot, serial: list[str]) -> None:
    """Raise InputError where a moving joint mimics another one or is mimicked."""
    for joint in robot.joints:
        if joint.mimics is not None and (joint.name in serial or joint.mimics in serial):
            raise InputError(
                f"plant.arm.joints: {joint.name!r} mimics {joint.mimics!r}, and coupled joints are "
                "not supported; leave both out (they are fixed at 0)"
            )


def end(robot: Robot, moved: Sequence[str]) -> str:
    """The one link without children to which all of these joints lead."""
    parents = {joint.parent for joint in robot.joints}
    ends = []
    for link in robot.links:
        way = {joint.name for joint in robot.way(link)}
        if link not in parents and set(moved) <= way:
            ends.append(link)
    if not ends:
        raise InputError(
            f"plant.arm.tip: the movable joints branch at {_parting(robot, moved)!r}: the arm must "
            "be a serial chain; name the link in which it ends, such as that one (joints elsewhere "
            "are fixed at 0)"
        )
    if len(ends) > 1:
        raise InputError(f"plant.arm.tip: the arm ends in {', '.join(ends)}: name one of them")
    return ends[0]


def _parting(robot: Robot, moved: Sequence[str]) -> str:
    """The link at which the ways to these joints part."""
    joints = {joint.name: joint for joint in robot.joints}
    ways = [robot.way(joints[name].child) for name in moved]
    above: set[str] = set()
    for way in ways:
        above.update(joint.name for joint in way[:-1])
    last = [way[:-1] for way in ways if way[-1].name not in above]
    link = next(name for name in robot.links if not robot.way(name))
    for together in zip(*last, strict=False):
        if len({joint.name for joint in together}) > 1:
            break
        link = together[0].child
    return link


class _Functions(NamedTuple):
    """M(masses, q), h(masses, q, v), points(q) and turn(q) of a `Chain`.

    masses: masses of the bodies, then the payload (N + 1) [kg].
    """

    mass: ca.Function
    bias: ca.Function
    points: ca.Function
    turn: ca.Function


def _functions(moving: list[Joint], frames: Frames, gravity: Floats) -> _Functions:
    """The functions of a chain, by adam."""
    N = len(moving)
    masses = ca.SX.sym("m", N + 1)
    q, v = ca.SX.sym("q", N), ca.SX.sym("v", N)
    adam = algorithms(moving, frames, masses)
    H = ca.SX(np.eye(4))  # pose of the base

    def pose(frame: str) -> Any:
        return adam.forward_kinematics(frame, H, q).array

    base_twist, base_gravity = ca.SX(6, 1), ca.SX(np.r_[gravity, 0, 0, 0])
    h = adam.rnea(H, q, base_twist, v, base_gravity).array  # of the base (6), then of the joints
    M = adam.crba(H, q)[0].array
    origins = [pose(f"origin {i}")[:3, 3].T for i in range(N)]
    tip = pose("tip")
    points = ca.vertcat(ca.SX(1, 3), *origins, tip[:3, 3].T)
    return _Functions(
        _function("mass", [masses, q], M[6:, 6:]),
        _function("bias", [masses, q, v], h[6:]),
        _function("points", [q], points),
        _function("turn", [q], tip[:3, :3] @ ca.SX(frames.turn)),
    )


def _function(name: str, inputs: list[ca.SX], value: Any) -> ca.Function:
    """A dense function whose common subexpressions are computed once."""
    return ca.Function(name, inputs, [ca.densify(value)], {"cse": True})
