"""URDF files: links and joints of a tree, each number checked."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError, fromstring

from undeadzone.errors import FileError
from undeadzone.plants.robots.urdf_elements import Body, Joint, body_of, joint_of, name_of
from undeadzone.support.files import read_bytes, reason


class Robot(NamedTuple):
    """A tree.

    Attributes:
        links: the bodies of the links, by name; massless without <inertial>.
        joints: the joints, in the file's order.
    """

    links: dict[str, Body]
    joints: list[Joint]

    def way(self, link: str) -> list[Joint]:
        """The joints from the base to a link."""
        above = {joint.child: joint for joint in self.joints}
        upward = []
        while joint := above.get(link):
            upward.append(joint)
            link = joint.parent
        return upward[::-1]


def read(path: Path, key: str = "plant.arm.path") -> Robot:
    """The tree of a URDF file.

    Args:
        path: the file.
        key: name of the file in messages.

    Raises:
        FileError: naming the key, the file and the element.
    """
    try:
        root = fromstring(read_bytes(path))
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


def _robot(root: Element) -> Robot:
    """The tree under <robot>. Raises ValueError."""
    if root.tag != "robot":
        raise ValueError("not a URDF: its first element is not <robot>")
    if any("xacro" in element.tag for element in root.iter()):
        raise ValueError("holds xacro macros: expand them first (xacro arm.xacro > arm.urdf)")
    elements = root.findall("link")
    links = {name_of(element): body_of(element) for element in elements}
    joints = [joint_of(element) for element in root.findall("joint")]
    if len(elements) != len(links):
        raise ValueError("two links have the same name")
    if len(joints) != len({joint.name for joint in joints}):
        raise ValueError("two joints have the same name")
    for joint in joints:
        for end in (joint.parent, joint.child):
            if end not in links:
                raise ValueError(f"joint {joint.name}: no link {end!r}; {suggest(end, links)}")
    _require_tree(list(links), joints)
    return Robot(links, joints)


def _require_tree(links: list[str], joints: list[Joint]) -> None:
    """Raise ValueError unless the joints connect the links to one base, each by one way."""
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
