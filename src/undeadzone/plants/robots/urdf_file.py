"""URDF files: links and joints of a tree, each number checked."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError, fromstring

import numpy as np

from undeadzone.errors import FileError
from undeadzone.support.arrays import Floats, numeric
from undeadzone.support.files import reason

MOVABLE = "revolute", "continuous", "prismatic"
TRIANGLE = 1e-9  # of an inertia's largest principal moment: rounding of the file's digits


class Joint(NamedTuple):
    """A <joint>: the child link's place (3) [m] and turn (3 x 3) on the parent, the unit axis (3), the joint that it mimics, or None.

    limits [rad] or [m], effort [N m] or [N], velocity [rad/s] or [m/s]: infinite where the file says nothing; friction: viscous and Coulomb.
    """

    name: str
    kind: str
    parent: str
    child: str
    place: Floats
    turn: Floats
    axis: Floats
    mimics: str | None
    limits: tuple[float, float]
    effort: float
    velocity: float
    friction: tuple[float, float]


class Body(NamedTuple):
    """Mass [kg], its centre (3) [m] and the inertia about it (3 x 3) [kg m^2], in the same coordinates."""

    mass: float
    centre: Floats
    inertia: Floats


class Robot(NamedTuple):
    """A tree: the bodies of its links, by name (massless without <inertial>), and the joints in the file's order."""

    links: dict[str, Body]
    joints: list[Joint]

    def way(self, link: str) -> list[Joint]:
        """The joints from the base to a link."""
        above = {joint.child: joint for joint in self.joints}
        found = []
        while joint := above.get(link):
            found.append(joint)
            link = joint.parent
        return found[::-1]


def read(path: Path, key: str = "plant.arm.path") -> Robot:
    """The tree of a URDF file. Raises FileError, naming the key, the file and the element."""
    try:
        root = fromstring(path.read_bytes())
    except (OSError, ValueError, LookupError) as error:
        raise FileError(f"{key}: {path}: cannot read: {reason(error)}") from None
    except ParseError as error:
        raise FileError(f"{key}: {path}: not XML: {error}") from None
    try:
        return _robot(root)
    except ValueError as error:
        raise FileError(f"{key}: {path}: {error}") from None


def suggest(name: str, known: Iterable[str]) -> str:
    """Which of the known names may be meant."""
    known = list(known)
    near = difflib.get_close_matches(name, known, 1)
    return f"did you mean {near[0]!r}?" if near else f"the file has {', '.join(known) or 'none'}"


def rotation(roll: float, pitch: float, yaw: float) -> Floats:
    """Rotation matrix (3 x 3) of the turns [rad] about the fixed axes x, then y, then z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def _robot(root: Element) -> Robot:
    if root.tag != "robot":
        raise ValueError(f"not a URDF: expected <robot>, found <{root.tag}>")
    if any("xacro" in element.tag for element in root.iter()):
        raise ValueError("holds xacro macros: expand them first (xacro arm.xacro > arm.urdf)")
    links = {_name(element): _body(element) for element in root.findall("link")}
    joints = [_joint(element) for element in root.findall("joint")]
    for what, found, unique in (
        ("link", root.findall("link"), links),
        ("joint", joints, {joint.name for joint in joints}),
    ):
        if len(found) != len(unique):
            raise ValueError(f"two {what}s have the same name")
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ValueError(f"joint {joint.name}: no link {end!r}; {suggest(end, links)}")
    children = [joint.child for joint in joints]
    twice = sorted({child for child in children if children.count(child) > 1})
    if twice:
        raise ValueError(
            f"link {twice[0]} has two parents (a closed loop): the arm must be a serial chain"
        )
    bases = [link for link in links if link not in children]
    if len(bases) != 1:
        raise ValueError(f"expected one base link, found {', '.join(bases) or 'none'}")
    reached = bases
    for link in reached:
        reached.extend(joint.child for joint in joints if joint.parent == link)
    if len(reached) < len(links):
        raise ValueError(
            f"link {next(link for link in links if link not in reached)} is not connected to the base {bases[0]}"
        )
    return Robot(links, joints)


def _joint(element: Element) -> Joint:
    name, kind = _name(element), element.get("type", "")
    where = f"joint {name}"
    if kind not in (*MOVABLE, "fixed"):
        raise ValueError(
            f"{where}: type must be fixed, {', '.join(MOVABLE)}, found {kind!r}; the base must be fixed, and each joint turn or slide along one axis"
        )
    (parent, child), (limit, dynamics, mimic) = (
        (element.find(tag) for tag in tags)
        for tags in (("parent", "child"), ("limit", "dynamics", "mimic"))
    )
    if parent is None or child is None:
        raise ValueError(f"{where}: needs <parent link=...> and <child link=...>")
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0), where)
    if not (length := np.linalg.norm(axis)) > 0 and kind != "fixed":
        raise ValueError(f"{where}: its axis is zero")
    free = kind == "continuous"
    lower, upper = (
        _number(None if free else limit, side, sign * math.inf, where)
        for side, sign in (("lower", -1), ("upper", 1))
    )
    effort, velocity = (_number(limit, side, math.inf, where) for side in ("effort", "velocity"))
    friction = _number(dynamics, "damping", 0.0, where), _number(dynamics, "friction", 0.0, where)
    if kind != "fixed" and not lower < upper:
        raise ValueError(
            f"{where}: limit lower = {lower:g} must be less than upper = {upper:g}; remove both where there is no limit"
        )
    if kind != "fixed" and not min(effort, velocity) > 0:
        raise ValueError(
            f"{where}: limit effort and velocity must be positive, found {effort:g} and {velocity:g}; remove them where there is no limit"
        )
    if min(friction) < 0:
        raise ValueError(
            f"{where}: damping and friction must not be negative, found {friction[0]:g} and {friction[1]:g}"
        )
    mimics = None if mimic is None else mimic.get("joint", "")
    place, turn = _pose(element, where)
    return Joint(
        name,
        kind,
        parent.get("link", ""),
        child.get("link", ""),
        place,
        turn,
        axis / (length or 1),
        mimics,
        (lower, upper),
        effort,
        velocity,
        friction,
    )


def _body(element: Element) -> Body:
    inertial, where = element.find("inertial"), f"link {_name(element)}"
    if inertial is None:
        return Body(0.0, np.zeros(3), np.zeros((3, 3)))
    centre, turn = _pose(inertial, where)
    mass = _number(inertial.find("mass"), "value", 0.0, where)
    xx, xy, xz, yy, yz, zz = (
        _number(inertial.find("inertia"), f"i{pair}", 0.0, where)
        for pair in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    a, b, c = np.linalg.eigvalsh(inertia)
    if mass < 0:
        raise ValueError(f"{where}: mass must not be negative, found {mass:g}")
    if a < -TRIANGLE * c:
        raise ValueError(
            f"{where}: inertia must be positive definite, found the principal moments {a:g}, {b:g}, {c:g}"
        )
    if a + b < c * (1 - TRIANGLE):
        raise ValueError(
            f"{where}: no body has the principal moments {a:g}, {b:g}, {c:g}: the largest must not exceed the sum of the others"
        )
    return Body(mass, centre, turn @ inertia @ turn.T)


def _name(element: Element) -> str:
    if not (name := element.get("name", "")):
        raise ValueError(f"a <{element.tag}> has no name")
    return name


def _pose(element: Element, where: str) -> tuple[Floats, Floats]:
    """<origin> as place and turn."""
    origin = element.find("origin")
    return _numbers(origin, "xyz", (0.0, 0.0, 0.0), where), rotation(
        *_numbers(origin, "rpy", (0.0, 0.0, 0.0), where)
    )


def _number(element: Element | None, name: str, otherwise: float, where: str) -> float:
    return float(_numbers(element, name, (otherwise,), where)[0])


def _numbers(
    element: Element | None, name: str, otherwise: tuple[float, ...], where: str
) -> Floats:
    """Numbers of an attribute, as many as it has otherwise."""
    if element is None or (text := element.get(name)) is None:
        return np.array(otherwise)
    try:
        found = numeric([float(word) for word in text.split()])
    except ValueError:
        found = np.empty(0)
    if found.size != len(otherwise):
        raise ValueError(
            f"{where}: <{element.tag} {name}={text!r}>: expected {len(otherwise)} finite number{'s' * (len(otherwise) > 1)}"
        )
    return found
