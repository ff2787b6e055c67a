"""URDF files for `arms`: attributes and elements of an arm changed one at a time."""

from __future__ import annotations

import copy
import random
from pathlib import Path
from xml.etree import ElementTree

from tools.fuzz.damage import TEXTS, number

ARM = (Path(__file__).parents[2] / "examples" / "ur5.urdf").read_bytes()
SMALL = b"""<robot name="r"><link name="a"/>
<link name="b"><inertial><origin xyz="0.1 0 0" rpy="0 0 0"/><mass value="1.0"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.1" rpy="0 0 0"/><limit lower="-1" upper="1" effort="10" velocity="2"/>
<dynamics damping="0.1" friction="0.05"/></joint></robot>"""


def changed(draw: random.Random, content: bytes) -> bytes:
    """A file with one to three elements or attributes changed."""
    root = ElementTree.fromstring(content)
    for _ in range(draw.choice((1, 1, 2, 3))):
        every = list(root.iter())
        element = draw.choice(every)
        act = draw.randrange(7)
        if act == 0 and len(every) > 1:
            parent = draw.choice([each for each in every if len(each)] or [root])
            parent.remove(draw.choice(list(parent))) if len(parent) else None
        elif act == 1:
            draw.choice(every).append(copy.deepcopy(element))
        elif act == 2:
            element.tag = draw.choice(("link", "joint", "mass", "xacro:x", "robot", "mimic"))
        elif element.attrib:
            key = draw.choice(list(element.attrib))
            element.attrib[key] = _word(draw, element.attrib[key])
    try:
        return ElementTree.tostring(root)
    except (RecursionError, ValueError):
        return content


def _word(draw: random.Random, before: str) -> str:
    """Another value of an attribute."""
    act = draw.randrange(4)
    if act == 0:
        return draw.choice(TEXTS).translate({27: None, 10: None})
    words = before.split() or [""]
    if act == 1:
        words[draw.randrange(len(words))] = repr(number(draw))
    elif act == 2:
        words = words[:-1]
    else:
        words = [repr(number(draw)) for _ in range(draw.choice((1, 3)))]
    return " ".join(words)
