"""Whether the parts of a scenario that is made in Python are what they should be."""

from __future__ import annotations

from typing import Any, Final

from undeadzone.errors import InputError
from undeadzone.plants.options import Plant
from undeadzone.sensor import Sensor
from undeadzone.support.arrays import array

CURES: Final = {
    "plant": "uz.Plant(A=..., B=..., C=...), or uz.from_control(system)",
    "sensor": "uz.Sensor(right=..., left=...)",
    "reference": "a signal such as uz.Sine(amplitude=..., frequency=...)",
    "observer": "options such as uz.Auto(right=[0.0, 2.0])",
    "controller": "options such as uz.StateFeedback()",
}


def require_kinds(parts: dict[str, Any]) -> None:
    """Raise InputError where a part is of another type, such as a name, a number or a system.

    Args:
        parts: plant, sensor, reference, observer and controller of a scenario; the last two may be
            None.
    """
    sound = {
        "plant": isinstance(parts["plant"], Plant),
        "sensor": isinstance(parts["sensor"], Sensor),
        "reference": hasattr(parts["reference"], "__struct_fields__"),
        "observer": parts["observer"] is None or hasattr(parts["observer"], "build"),
        "controller": parts["controller"] is None or hasattr(parts["controller"], "build"),
    }
    for name, is_sound in sound.items():
        if not is_sound:
            found = type(parts[name]).__name__
            raise InputError(f"{name}: expected {CURES[name]}, found {found}")
    for side in ("right", "left"):
        array(f"sensor.{side}", getattr(parts["sensor"], side))
