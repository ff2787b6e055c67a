"""From the gears of a motor that were fitted to its log to those of a joint of an arm."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.scenario.problem import systems
from undeadzone.scenario.reader import anchor_files, read
from undeadzone.scenario.schema import Scenario
from undeadzone.util import toml
from undeadzone.util.own_files import write_own_file
from undeadzone.util.text import suggest_name
from undeadzone_identify.fitting.result import Fitted

GEARS: Final = "plant.arm.gears."


class Place(NamedTuple):
    """Joint of an arm.

    Attributes:
        name: of the file of the arm's scenario.
        arm: the scenario.
        joint: number of the joint.
        size: number of joints.
    """

    name: str
    arm: Scenario
    joint: int
    size: int


def read_place(path: Path, joint: str) -> Place:
    """Read the scenario of an arm with gears, and which of its joints is meant.

    Args:
        path: of the scenario.
        joint: name of the joint.

    Raises:
        FileError: the file cannot be read.
        InputError: it lacks gears, or this joint.
    """
    arm = read(path)
    gears = systems(arm)[0].gears
    if gears is None:
        raise InputError(f"{path}: plant.arm.gears: missing. undeadzone arm ROBOT --gears has them")
    joints = gears.arm.chain.joints
    if joint not in joints:
        raise InputError(f"--joint {joint}: {suggest_name(joint, joints, 'The arm has')}")
    return Place(path.name, arm, joints.index(joint), len(joints))


def put_gears(found: Fitted, place: Place) -> Scenario:
    """Return the scenario of an arm with the gears that logs determined for one of its joints.

    Other numbers of the arm stay, and so do the observer's ranges.

    Args:
        found: a fitted motor.
        place: the joint.

    Raises:
        InputError: the logs determine no number of them.
    """
    _, arm, joint, size = place
    gears = getattr(arm.plant.arm, "gears", None)
    known = [each for each in found.numbers if each.name.startswith(GEARS) and each.shown]
    if not known:
        raise InputError("--arm: the logs determine no number of plant.arm.gears")
    for each in known:
        key = each.name.partition("[")[0]
        own = getattr(gears, key.removeprefix(GEARS))
        if own is None:
            raise InputError(f"{key}: missing in the arm, which needs it of every joint")
        numbers = np.broadcast_to(np.asarray(own, float), size).copy()
        numbers[joint] = each.value
        arm = arm.replace(key, numbers.tolist())
    return arm


def write_arm(found: Fitted, place: Place, folder: Path, force: bool) -> Path:
    """Write the scenario of an arm with the gears of a fitted motor, and return its path.

    Args:
        found: the fitted motor.
        place: the joint.
        folder: where to.
        force: whether a changed file is replaced.

    Raises:
        FileError, InputError: it cannot be written, or nothing was found.
    """
    here = Path(os.path.relpath(Path(), folder))
    text = toml.to_toml(anchor_files(put_gears(found, place), here))
    return write_own_file(text, folder / place.name, force)
