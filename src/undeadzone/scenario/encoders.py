"""Arms with gears: what reads them, drives them and follows them; the rest is refused.

Encoders at motors and links read positions without a zone; what is hidden hides in the gaps of the
gears, and only methods that say so know these (`gears = True` of their options).
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from undeadzone.ends.sensor import Sensor
from undeadzone.errors import InputError
from undeadzone.plants.system import System

ZONE = ("right", "left", "noise_before", "drift", "play", "load_friction", "load_inertia")


def encoders(sensor: Sensor, model: System) -> Sensor:
    """The sensor, for which no reading of an encoder is silent.

    Args:
        sensor: in a user's words.
        model: what it reads.

    Raises:
        InputError: it has a dead zone or a play, and the model has gears.
    """
    if model.gears is None:
        return sensor
    zones = [name for name in ZONE if np.any(getattr(sensor, name))]
    if zones or sensor.kind != "deadzone":
        raise InputError(
            f"sensor.{(zones or ['kind'])[0]}: an arm with gears is read by encoders, whose gap is "
            "plant.arm.gears.half; set sensor.right = 0 and sensor.left = 0, and leave it out "
            "elsewhere"
        )
    return msgspec.structs.replace(sensor, threshold=0.0)


def require_gears(kind: str, options: Any, model: System) -> None:
    """Raise InputError where a method does not know the gears of a model.

    Args:
        kind: of the method: observer or controller.
        options: of the method.
        model: what it is for.
    """
    if model.gears is None or getattr(options, "gears", False):
        return
    known = {"observer": "'contact' or 'full_state'", "controller": "'computed_torque'"}
    raise InputError(
        f"{kind}.method: {options.__struct_config__.tag!r} takes motors for links, and this arm "
        f"has gears with a gap between them; use {known[kind]}, or leave plant.arm.gears out"
    )
