"""Levels of z between the sides that a noise-free sensor reads, and the sides on given outputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.play import contacts
from undeadzone.sensor import Zone, edges, zone
from undeadzone.support.arrays import Floats


class Read(NamedTuple):
    """What a noise-free sensor reads of outputs (N x p each).

    Attributes:
        side: +1, -1 where a reading is exact, else 0.
        limited: whether it is at a limit of its range.
    """

    side: Floats
    limited: np.ndarray

    def share(self, weight: Floats) -> Floats:
        """The share of the readings beyond an edge that are exact (p); 1 if none is beyond one.

        Args:
            weight: of each row (N), such as how long it lasts.
        """
        exact = weight @ (self.side != 0)
        beyond = exact + weight @ self.limited
        return np.asarray(np.where(beyond > 0, exact / np.where(beyond > 0, beyond, 1.0), 1.0))


def reading_levels(sensor: Zone) -> Floats:
    """Levels (p x 2) of z: a noise-free sensor reads right above the first, left below -second.

    Of a play they are its gaps: no level of z tells its side.
    """
    if sensor.kind == "play":
        return np.stack((sensor.right, sensor.left), axis=1)
    right, left = edges(sensor.right, sensor.left, sensor.slope, sensor.kind, sensor.threshold)
    return np.stack((right, left), axis=1)


def limit_levels(sensor: Zone) -> Floats | None:
    """Levels (p x 2) of z: at a limit above the first and below -second; None: no range."""
    if sensor.limits is None:
        return None
    low, high = sensor.limits
    widths = sensor.right, sensor.left, sensor.slope, sensor.kind
    return np.stack((edges(*widths, high)[0], edges(*widths, -low)[1]), axis=1)


def reading(z: Floats, sensor: Zone, again: bool = False) -> Read:
    """What the sensor reads of outputs z (N x p) without noise.

    Args:
        z: outputs (N x p), one after the other.
        sensor: the dead zone.
        again: whether they repeat, so that a play had its first pass before.
    """
    if sensor.kind == "play":
        return _reading_of_play(z, sensor, again)
    side = zone(z, *reading_levels(sensor).T)
    limits = limit_levels(sensor)
    if limits is None:
        return Read(side, np.zeros(z.shape, bool))
    limited = zone(z, *limits.T) != 0
    return Read(np.where(limited, 0.0, side), limited)


def _reading_of_play(z: Floats, sensor: Zone, again: bool) -> Read:
    """`reading` of a play: the side is that of the contact in which the level moves."""
    passes = np.concatenate([z, z]) if again else z
    sides = contacts(passes, sensor.right, sensor.left, sensor.start)[-len(z) :]
    if sensor.limits is None:
        return Read(sides, np.zeros(z.shape, bool))
    low, high = sensor.limits
    limited = (z - sensor.right >= high / sensor.slope) | (z + sensor.left <= low / sensor.slope)
    return Read(np.where(limited, 0.0, sides), limited)
