"""Gears with backlash for MuJoCo, from the estimates of a run or of a servo's log.

Each joint becomes two hinges at one place: the motor, with its inertia and friction, and the gap,
which the link may turn from there. Friction of the link is that of a tendon over both.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np

from undeadzone.results.run import Run, final_side_rows, final_width_rows
from undeadzone.scenario.problem import systems
from undeadzone.scenario.reader import parse
from undeadzone.util.files import write_text

FILE = "gears.xml"
FIRM = "0.99 0.99 0.0001"  # solimplimit of the ends of a gap
USE = (
    ' Include this file in a model whose compiler says angle="radian". Each joint then is two: '
    '<joint name="q" class="q_motor"/> <joint name="q_gap" class="q_gap"/>, with the same axis. '
)


class Joint(NamedTuple):
    """Gears of a joint.

    Attributes:
        name: of the joint.
        words: description of its gap.
        behind, ahead: how far the link may be behind its motor and ahead of it [rad].
        inertia: of the motor as felt at the joint [kg m^2].
        friction, viscous: of the motor [N m], [N m s/rad].
        link: the same two of the link.
        contact: natural frequency [rad/s] and damping ratio of the ends (None: as MuJoCo has them).
    """

    name: str
    words: str
    behind: float
    ahead: float
    inertia: float
    friction: float
    viscous: float
    link: tuple[float, float] = (0.0, 0.0)
    contact: tuple[float, float] | None = None


def joints_from_run(run: Run) -> list[Joint]:
    """Return the gears estimated in a run, the rest from its model, or empty without an estimate.

    Args:
        run: with its scenario.
    """
    gears = systems(parse(run.info.scenario))[1].gears
    if gears is None or run.d_std is None or run.divergence_time is not None:
        return []
    found = dict(zip(gears.names, gears.values.tolist(), strict=True))
    found |= {name: one["estimate"] for name, one in run.parameters.items()}
    values = np.array([found[name] for name in gears.names])
    K, D = (np.asarray(each).ravel() for each in gears.contact_stiffness(values))
    frequency = np.sqrt(K / gears.stiffness)
    damping = D / gears.stiffness / frequency / 2
    joints = []
    rows = zip(run.info.joints, final_side_rows(run), final_width_rows(run), strict=False)
    for i, (name, (right, left), (gap, centre)) in enumerate(rows):
        joint = Joint(
            name,
            f"the gap is {gap.value_with_interval} rad, "
            f"its centre {centre.value_with_interval} rad",
            behind=left.value or 0.0,
            ahead=right.value or 0.0,
            inertia=found[f"inertia{i + 1}"],
            friction=found[f"friction{i + 1}"],
            viscous=found[f"viscous{i + 1}"],
            link=(found.get(f"f{i + 1}", 0.0), found.get(f"b{i + 1}", 0.0)),
            contact=(frequency[i], damping[i]),
        )
        joints.append(joint)
    return joints


def write_gears(joints: list[Joint], folder: Path) -> list[Path]:
    """Write joints to a folder, as MuJoCo's default classes and tendons, nothing for no
    joints.

    Args:
        joints: of an arm.
        folder: where to.

    Returns:
        Paths of the written files.

    Raises:
        FileError: the file cannot be written.
    """
    if not joints:
        return []
    root = Element("mujoco")
    root.append(Comment(USE))
    classes = SubElement(root, "default")
    tendons = SubElement(root, "tendon")
    for joint in joints:
        classes.append(Comment(f" {joint.name}: {joint.words} ".replace("--", "-")))
        motor = f"{joint.name}_motor"
        gap = f"{joint.name}_gap"
        parts = _format_attributes(
            armature=joint.inertia, frictionloss=joint.friction, damping=joint.viscous
        )
        SubElement(SubElement(classes, "default", {"class": motor}), "joint", parts)
        ends = _format_attributes(range=(-joint.behind, joint.ahead)) | {"limited": "true"}
        if joint.contact is not None:
            rate, ratio = joint.contact
            ends |= _format_attributes(solreflimit=(-(rate**2), -2 * ratio * rate)) | {
                "solimplimit": FIRM
            }
        SubElement(SubElement(classes, "default", {"class": gap}), "joint", ends)
        parts = _format_attributes(frictionloss=joint.link[0], damping=joint.link[1])
        tendon = SubElement(tendons, "fixed", {"name": f"{joint.name}_link"} | parts)
        for name in (joint.name, gap):
            SubElement(tendon, "joint", {"joint": name, "coef": "1"})
    indent(root)
    return [write_text(tostring(root, encoding="unicode") + "\n", folder / FILE)]


def _format_attributes(**values: float | tuple[float, ...]) -> dict[str, str]:
    """Return numeric attributes of an XML element as text."""
    found = {}
    for name, value in values.items():
        entries = value if isinstance(value, tuple) else (value,)
        found[name] = " ".join(f"{entry:.6g}" for entry in entries)
    return found
