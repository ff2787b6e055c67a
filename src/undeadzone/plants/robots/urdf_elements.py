"""Elements of URDF files: joints and links of a tree, their numbers, each checked.

A reader of an element raises ValueError, which names it. `read` adds the key and the file.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, fromstring

import numpy as np

from undeadzone.errors import FileError
from undeadzone.util.arrays import Floats, to_float_array
from undeadzone.util.files import convert_read_errors, read_bytes
from undeadzone.util.text import suggest_name

MOVABLE = "revolute", "continuous", "prismatic"
TRIANGLE = 1e-9  # of an inertia's largest principal moment: rounding of the file's digits


class Joint(NamedTuple):
    """Element <joint> of the file.

    Attributes:
        name: name of the joint.
        kind: revolute, continuous, prismatic or fixed.
        parent, child: the links that it joins.
        place: place of the child link on the parent (3) [m].
        turn: rotation matrix of the child link on the parent (3 x 3).
        axis: axis of motion, a unit vector (3).
        mimics: name of the joint that it mimics, or None.
        limits: least and greatest position [rad or m], infinite if the file has none.
        effort: largest torque [N m] or force [N], infinite if the file has none.
        velocity: largest speed [rad/s or m/s], infinite if the file has none.
        friction: viscous [N m s/rad] and Coulomb [N m] coefficients.
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
    """Rigid body: mass, centre of mass and inertia.

    Attributes:
        mass: mass of the body [kg].
        centre: centre of mass (3) [m].
        inertia: inertia about the centre, in the same coordinates (3 x 3) [kg m^2].
    """

    mass: float
    centre: Floats
    inertia: Floats


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """Return the rotation matrix (3 x 3) of the turns [rad] about the fixed axes x, then y,
    then z.
    """
    (cx, cy, cz) = np.cos([roll, pitch, yaw])
    (sx, sy, sz) = np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def parse_joint(element: Element) -> Joint:
    """Return a <joint>. Raises ValueError."""
    name = require_element_name(element)
    kind = element.get("type", "")
    where = f"joint {name}"
    if kind not in (*MOVABLE, "fixed"):
        raise ValueError(
            f"{where}: type must be fixed, {', '.join(MOVABLE)}, found {kind!r}. "
            "The base must be fixed, and each joint turn or slide along one axis"
        )
    parent = element.find("parent")
    child = element.find("child")
    if parent is None or child is None:
        raise ValueError(f"{where}: needs <parent link=...> and <child link=...>")
    axis = _parse_axis(element, kind, where)
    limits, effort, velocity = _parse_limits(element.find("limit"), kind, where)
    friction = _parse_friction(element.find("dynamics"), where)
    mimic = element.find("mimic")
    place, turn = _parse_origin(element, where)
    return Joint(
        name=name,
        kind=kind,
        parent=parent.get("link", ""),
        child=child.get("link", ""),
        place=place,
        turn=turn,
        axis=axis,
        mimics=None if mimic is None else mimic.get("joint", ""),
        limits=limits,
        effort=effort,
        velocity=velocity,
        friction=friction,
    )


def _parse_axis(element: Element, kind: str, where: str) -> Floats:
    """Return the unit axis (3) of a <joint>, optional for a fixed joint. Raises ValueError."""
    axis = _parse_attribute_vector(element.find("axis"), "xyz", (1.0, 0.0, 0.0), where)
    length = np.linalg.norm(axis)
    if not length > 0 and kind != "fixed":
        raise ValueError(f"{where}: its axis is zero")
    return axis / (length or 1)


def _parse_limits(
    limit: Element | None, kind: str, where: str
) -> tuple[tuple[float, float], float, float]:
    """Return (lower and upper position, effort, velocity) of a <limit>, infinite if absent.

    Raises ValueError unless a joint that is not fixed can move.
    """
    bounded = None if kind == "continuous" else limit
    lower = _parse_attribute(bounded, "lower", -math.inf, where)
    upper = _parse_attribute(bounded, "upper", math.inf, where)
    effort = _parse_attribute(limit, "effort", math.inf, where)
    velocity = _parse_attribute(limit, "velocity", math.inf, where)
    if not lower < upper and kind != "fixed":
        raise ValueError(
            f"{where}: limit lower = {lower:g} must be less than upper = {upper:g}. "
            "Remove both if there is no limit"
        )
    if not min(effort, velocity) > 0 and kind != "fixed":
        raise ValueError(
            f"{where}: limit effort and velocity must be positive, "
            f"found {effort:g} and {velocity:g}. Remove them if there is no limit"
        )
    return (lower, upper), effort, velocity


def _parse_friction(dynamics: Element | None, where: str) -> tuple[float, float]:
    """Return viscous and Coulomb coefficients of a <dynamics>. Raises ValueError."""
    viscous = _parse_attribute(dynamics, "damping", 0.0, where)
    coulomb = _parse_attribute(dynamics, "friction", 0.0, where)
    if min(viscous, coulomb) < 0:
        raise ValueError(
            f"{where}: damping and friction must not be negative, found {viscous:g} and {coulomb:g}"
        )
    return viscous, coulomb


def parse_body(element: Element) -> Body:
    """Return the body of a <link>, in its coordinates. Raises ValueError."""
    inertial = element.find("inertial")
    where = f"link {require_element_name(element)}"
    if inertial is None:
        return Body(0.0, np.zeros(3), np.zeros((3, 3)))
    centre, turn = _parse_origin(inertial, where)
    mass = _parse_attribute(inertial.find("mass"), "value", 0.0, where)
    inertia = _parse_inertia(inertial.find("inertia"), where)
    if mass < 0:
        raise ValueError(f"{where}: mass must not be negative, found {mass:g}")
    return Body(mass, centre, turn @ inertia @ turn.T)


def _parse_inertia(element: Element | None, where: str) -> Floats:
    """Return the matrix (3 x 3) [kg m^2] of an <inertia>.

    Raises ValueError unless a body can have it.
    """
    xx, xy, xz, yy, yz, zz = (
        _parse_attribute(element, f"i{pair}", 0.0, where)
        for pair in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    a, b, c = np.linalg.eigvalsh(inertia)  # the principal moments, the largest last
    if a < -TRIANGLE * c:
        raise ValueError(
            f"{where}: inertia must be positive definite, "
            f"found the principal moments {a:g}, {b:g}, {c:g}"
        )
    if a + b < c * (1 - TRIANGLE):
        raise ValueError(
            f"{where}: no body has the principal moments {a:g}, {b:g}, {c:g}: "
            "the largest must not exceed the sum of the others"
        )
    return inertia


def require_element_name(element: Element) -> str:
    """Return the name of an element. Raises ValueError for an element without a name."""
    name = element.get("name", "")
    if not name:
        raise ValueError(f"a <{element.tag}> has no name")
    return name


def _parse_origin(element: Element, where: str) -> tuple[Floats, Floats]:
    """Return <origin> as place (3) [m] and turn (3 x 3)."""
    origin = element.find("origin")
    place = _parse_attribute_vector(origin, "xyz", (0.0, 0.0, 0.0), where)
    return place, rotation_matrix(*_parse_attribute_vector(origin, "rpy", (0.0, 0.0, 0.0), where))


def _parse_attribute(element: Element | None, name: str, otherwise: float, where: str) -> float:
    """Return the number of an attribute, or the default if absent."""
    return float(_parse_attribute_vector(element, name, (otherwise,), where)[0])


def _parse_attribute_vector(
    element: Element | None, name: str, otherwise: tuple[float, ...], where: str
) -> Floats:
    """Return the numbers of an attribute, as many as its default has. Raises ValueError."""
    text = None if element is None else element.get(name)
    if element is None or text is None:
        return np.array(otherwise)
    try:
        numbers = to_float_array(list(map(float, text.split())))
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != len(otherwise):
        many = "s" * (len(otherwise) > 1)
        raise ValueError(
            f"{where}: <{element.tag} {name}={text!r}>: "
            f"expected {len(otherwise)} finite number{many}"
        )
    return numbers


class Robot(NamedTuple):
    """Tree of joints and links.

    Attributes:
        links: the bodies of the links, by name (massless without <inertial>).
        joints: the joints, in the file's order.
    """

    links: dict[str, Body]
    joints: list[Joint]

    def joints_to_link(self, link: str) -> list[Joint]:
        """Return the joints from the base to a link."""
        above = {joint.child: joint for joint in self.joints}
        upward = []
        while joint := above.get(link):
            upward.append(joint)
            link = joint.parent
        return upward[::-1]


def read_urdf(path: Path) -> Robot:
    """Return the tree of a URDF file.

    Args:
        path: the file.

    Raises:
        FileError: naming the key, the file and the element.
    """
    with convert_read_errors(f"plant.arm.path: {path}", "not XML", ". A robot is a URDF file"):
        root = fromstring(read_bytes(path))
    try:
        return _parse_robot(root)
    except ValueError as error:
        raise FileError(f"plant.arm.path: {path}: {error}") from None


def _parse_robot(root: Element) -> Robot:
    """Return the tree under <robot>. Raises ValueError."""
    if root.tag != "robot":
        raise ValueError("not a URDF: its first element is not <robot>. Convert it to URDF first")
    if any("xacro" in element.tag for element in root.iter()):
        raise ValueError("holds xacro macros: expand them first (xacro arm.xacro > arm.urdf)")
    elements = root.findall("link")
    links = {require_element_name(element): parse_body(element) for element in elements}
    joints = list(map(parse_joint, root.findall("joint")))
    if len(elements) != len(links):
        raise ValueError("two links have the same name")
    if len(joints) != len({joint.name for joint in joints}):
        raise ValueError("two joints have the same name")
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                advice = suggest_name(end, links, "The file has")
                raise ValueError(f"joint {joint.name}: no link {end!r}. {advice}")
    _require_tree(list(links), joints)
    return Robot(links, joints)


def _require_tree(links: list[str], joints: list[Joint]) -> None:
    """Raise ValueError unless the joints connect the links to a single base, each by a single
    way.
    """
    children = [joint.child for joint in joints]
    twice = sorted({child for child in children if children.count(child) > 1})
    if twice:
        raise ValueError(
            f"link {twice[0]} has two parents (a closed loop): the arm must be a serial chain"
        )
    bases = [link for link in links if link not in children]
    if len(bases) != 1:
        raise ValueError(f"expected one base link, found {', '.join(bases) or 'none'}")
    (base,) = bases
    reached = [base]
    for link in reached:  # grows as it is gone through
        reached.extend(joint.child for joint in joints if joint.parent == link)
    lost = [link for link in links if link not in reached]
    if lost:
        raise ValueError(f"link {lost[0]} is not connected to the base {base}")
