"""Measurement update through a dead zone for any Kalman filter, in Python and C.

The C header is `importlib.resources.files("deadzone_update") / "deadzone_update.h"`.
"""

from .errors import InputError, ShapeError, UndeadzoneError
from .numerics.deadzone_update import DeadzoneMemory, DeadzoneUpdate, deadzone_update

__all__ = [
    "DeadzoneMemory",
    "DeadzoneUpdate",
    "InputError",
    "ShapeError",
    "UndeadzoneError",
    "deadzone_update",
]
