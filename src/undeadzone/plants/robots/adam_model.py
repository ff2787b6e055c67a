"""The straightened chain of a file in the words of adam-robotics, which computes its dynamics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.plants.robots.frames import Frames, exact
from undeadzone.plants.robots.urdf_elements import Body, Joint
from undeadzone.support.arrays import Floats

LEVEL = [0.0, 0.0, 0.0]  # no turn


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
