"""Coulomb friction behind a play as an unknown of a filter: x' = A x + B (u - f s) (docs/play.md).

s is the side in which y moves, which the motion of the readings shows, so f enters like a width of
that side: the equations stay linear.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from undeadzone.observers.parts.further_constants import with_constants
from undeadzone.observers.parts.gaussian_filter import Augmentation
from undeadzone.sensor import Zone


def with_friction(inner: Augmentation, sensor: Zone) -> Augmentation:
    """The motion with the error of the friction as its last unknown, if it is not known."""
    if not sensor.friction_std.any():
        return inner
    return with_constants(inner, sensor.friction_std**2)


def against_friction(
    sensor: Zone, after: int, drive: Callable[[Any], Any], side: Any
) -> Callable[[Any], Any]:
    """What enters the plant, as a function of [x; d; extra], less the unknown part of the friction.

    Args:
        sensor: the play.
        after: how many unknowns stand after the friction's error.
        drive: what enters the plant without friction.
        side: in which y moves (1).
    """
    if not sensor.friction_std.any():
        return drive
    return lambda X: drive(X) - X[X.shape[0] - 1 - after] * side
