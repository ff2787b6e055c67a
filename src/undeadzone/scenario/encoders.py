"""Arms with gears: their sensors, actuators and observers. Other components are refused.

Encoders read positions without a zone. The gap is hidden: a link may be ahead of its motor by right
= a + c or behind it by left = a - c. Only methods that declare it know gaps of gears (`gears =
True` of their options).
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from undeadzone.analysis.identifiability.flanks import COUPLED
from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import SHAPE, Sensor, Zone, resolve
from undeadzone.plants.robots.geared import largest_couplings
from undeadzone.plants.system import System
from undeadzone.util.arrays import Floats

ZONE = ("right", "left", "noise_before", "drift", "play", "load_friction", "load_inertia", *SHAPE)


def resolve_sensor(sensor: Sensor, system: System, step: float, rate: float) -> Zone:
    """Return the checked sensor of a plant: for an arm with gears its encoders, with the gaps as
    widths.

    Args:
        sensor: in a user's words.
        system: plant that it reads, in continuous time.
        step: time between readings [s].
        rate: how fast the model moves [1/s], for the default rate of false alarms.

    Raises:
        InputError: or a subclass, as `resolve`, also for a dead zone or a play beside gears.
    """
    if system.gears is None:
        return resolve(sensor, system.p, step, rate)
    zones = [name for name in ZONE if np.any(getattr(sensor, name))]
    if zones or sensor.kind != "deadzone":
        raise InputError(
            f"sensor.{(zones or ['kind'])[0]}: an arm with gears is read by encoders, which have "
            "no zone. The gap is plant.arm.gears.half: set sensor.right and sensor.left to 0 and "
            "leave out all other keys of a zone"
        )
    always = msgspec.structs.replace(sensor, threshold=0.0)
    return with_gaps(resolve(always, system.p, step, rate), system)


def with_gaps(zone: Zone, system: System) -> Zone:
    """Return the sensor with the gaps of a plant's gears as widths, unchanged without gears."""
    if system.gears is None:
        return zone
    right, left = (np.asarray(each).ravel() for each in system.gears.gap_widths(system.params))
    return msgspec.structs.replace(zone, kind="gears", right=right, left=left)


def require_gears(kind: str, options: Any, system: System) -> None:
    """Raise InputError if a method does not know the gears of a plant.

    Args:
        kind: of the method: observer or controller.
        options: of the method.
        system: plant of the method.
    """
    if system.gears is None or getattr(options, "gears", False):
        return
    known = {"observer": "'contact' or 'full_state'", "controller": "'computed_torque'"}
    raise InputError(
        f"{kind}.method: {options.__struct_config__.tag!r} takes motors for links, and this arm "
        f"has gears with a gap between them. Use {known[kind]}, or leave plant.arm.gears out"
    )


def group_coupled_joints(options: Any, system: System, postures: Floats) -> Any:
    """Return the options of an observer, with pairs of coupled joints as groups.

    Only for a filter joint by joint that was given no groups. If more than two joints turn about
    nearly one axis they stay apart, and a run shows that their gaps cannot be known.

    Args:
        options: of the observer.
        system: plant of the method.
        postures: angles of the links that the motion visits (K x N).
    """
    gears = system.gears
    if gears is None or getattr(options, "joints", "") != "separate" or options.groups is not None:
        return options
    alone = [(joint,) for joint in range(gears.joint_count)]
    links = gears.link_params(np.ravel(system.params))
    partners: dict[int, set[int]] = {joint: set() for joint in range(gears.joint_count)}
    for joint, found in enumerate(largest_couplings(gears.arm, links, postures, alone)):
        if found.ratio > COUPLED:
            partners[joint].add(found.partner)
            partners[found.partner].add(joint)
    names = gears.arm.chain.joints
    pairs = []
    for joint, others in partners.items():
        for other in others:
            if joint < other and partners[other] == {joint} and others == {other}:
                pairs.append([names[joint], names[other]])
    return msgspec.structs.replace(options, groups=pairs)
