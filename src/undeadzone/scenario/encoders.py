"""Arms with gears: their sensors, actuators and observers. Other components are refused.

Encoders read positions without a zone. The gap is hidden: a link may be ahead of its motor by right
= a + c or behind it by left = a - c. Only methods that declare it know gaps of gears (`gears =
True` of their options).
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.sensor import SHAPE, Sensor, Zone, resolve
from undeadzone.plants.system import System

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
