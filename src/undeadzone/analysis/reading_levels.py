"""Levels of z between the sides that a noise-free sensor reads, and the sides on given outputs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.play import contacts, levels
from undeadzone.sensor import Zone, edges, zone
from undeadzone.support.arrays import Floats


class Read(NamedTuple):
    """What a noise-free sensor reads of outputs (N x p each).

    Attributes:
        side: +1, -1 where a reading is exact, else 0.
        limited: whether it is at a limit of its range.
        contact: of a play ahead of a dead zone, in which y moves; None: there is none.
    """

    side: Floats
    limited: np.ndarray
    contact: Floats | None = None

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

    Of a play they are its gaps: no level of z tells its side. Of a play ahead of a dead zone they
    are those at which z moves outwards.
    """
    if sensor.kind == "play":
        return np.stack((sensor.right, sensor.left), axis=1)
    right, left = edges(sensor.right, sensor.left, sensor.slope, sensor.kind, sensor.threshold)
    return np.stack((right, left), axis=1) + _gaps(sensor)


def limit_levels(sensor: Zone) -> Floats | None:
    """Levels (p x 2) of z: at a limit above the first and below -second; None: no range."""
    if sensor.limits is None:
        return None
    low, high = sensor.limits
    widths = sensor.right, sensor.left, sensor.slope, sensor.kind
    levels_of_zone = np.stack((edges(*widths, high)[0], edges(*widths, -low)[1]), axis=1)
    return np.asarray(levels_of_zone + _gaps(sensor))


def _gaps(sensor: Zone) -> Floats:
    """[c_r, c_l] of the play ahead of each dead zone (p x 2) [z]; 0 without one."""
    if sensor.play is None:
        return np.zeros((sensor.right.size, 2))
    return np.stack((sensor.play.right, sensor.play.left), axis=1)


def reading(z: Floats, sensor: Zone, again: bool = False) -> Read:
    """What the sensor reads of outputs z (N x p) without noise.

    Args:
        z: outputs (N x p), one after the other.
        sensor: the dead zone.
        again: whether they repeat, so that a play had its first pass before.
    """
    if sensor.kind == "play":
        return _reading_of_play(z, sensor, again)
    if sensor.play is not None:
        return _reading_of_both(z, sensor, again)
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


def _reading_of_both(z: Floats, sensor: Zone, again: bool) -> Read:
    """`reading` of a play ahead of a dead zone: exact beyond an edge, while the level moves."""
    assert sensor.play is not None
    gaps = sensor.play.right, sensor.play.left
    passes = np.concatenate([z, z]) if again else z
    contact = contacts(passes, *gaps, sensor.start)[-len(z) :]
    level = levels(passes, *gaps, sensor.start)[-len(z) :]
    outwards = reading_levels(sensor) - _gaps(sensor)
    side = zone(level, *outwards.T)
    limits = limit_levels(sensor)
    if limits is None:
        limited = np.zeros(z.shape, bool)
    else:
        limited = zone(level, *(limits - _gaps(sensor)).T) != 0
    return Read(np.where(limited | (contact == 0), 0.0, side), limited, contact)
