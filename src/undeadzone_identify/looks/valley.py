"""Gap of a drive by V curves: sweeps both ways through the place of the least reading."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats, turns
from undeadzone_identify.looks.rows import known_samples
from undeadzone_identify.models.estimates import Interval, student_quantile

TURN = 0.3  # of the range of u, from which a reversal begins a sweep
TAKEN_UP = 0.25  # first part of a sweep, in which the gap is taken up, to begin with
PASSES = 3  # refinements of that part by the gap that was found
SPARE = 1.2  # that part [gaps]
FEWEST = 6  # places of a sweep
SWEEPS = 3  # with a valley, from which there is a gap
SURE = 4  # sweeps, from which it is measured
FIT = 0.85  # share of the squared readings that a parabola explains, at least
INSIDE = 0.45  # distance of the least reading from the middle of a sweep, at most [its length]
SLOPING = 0.6  # correlation of reading and place, from which it is a line and no valley
FLOOR = 0.05  # of the largest squared reading, added where readings are weighted


class Valley(NamedTuple):
    """Distance of the places of the least reading between sweeps up and down.

    Attributes:
        gap: with its 95 % interval [u]; below 0 if the upward valleys come first.
        sweeps: with a valley.
    """

    gap: Interval
    sweeps: int

    @property
    def is_measured(self) -> bool:
        """Return whether sweeps and interval suffice for a number without doubt."""
        return self.sweeps >= SURE and self.gap.low > 0


def gap_between_valleys(u: Floats, y: Floats) -> Valley | None:
    """Return the gap of a drive by sweeps up and down through the least reading, or None.

    Args:
        u: commanded place (N).
        y: a reading above 0, as the size of a star (N).
    """
    _, u, y = known_samples(None, u, y)
    if y.size < SWEEPS * FEWEST or min(y.min(), np.ptp(u), np.ptp(y)) <= 0:
        return None
    if abs(np.corrcoef(u, y)[0, 1]) > SLOPING:
        return None
    cuts = turns(u, TURN * float(np.ptp(u)))
    sweeps = list(zip(np.split(u, cuts), np.split(y, cuts), strict=True))
    found, gap = None, 0.0
    for _ in range(PASSES):
        rows = [row for one in sweeps if (row := _least_reading(*one, SPARE * gap))]
        found = _difference(np.array(rows).reshape(-1, 2))
        gap = found.gap.value if found else 0.0
    return found


def _least_reading(place: Floats, y: Floats, skipped: float) -> tuple[float, float] | None:
    """Return place of the least reading and way of a sweep; None if it has no parabola.

    Args:
        place: commanded (N) [u].
        y: readings (N).
        skipped: way after a reversal, in which the gap is taken up [u].
    """
    way, length = float(np.sign(place[-1] - place[0])), float(np.ptp(place))
    taken = np.abs(place - place[0]) >= max(skipped, TAKEN_UP * length)
    x, z = place[taken], y[taken] ** 2
    if np.unique(x).size < FEWEST:
        return None
    middle, length = float(x.mean()), float(np.ptp(x))
    part = (x - middle) / length
    curve = np.polyfit(part, z, 2, w=1 / (z + FLOOR * z.max()))
    least = -curve[1] / (2 * curve[0])
    explained = 1 - np.var(z - np.polyval(curve, part)) / max(float(np.var(z)), 1e-300)
    if curve[0] <= 0 or explained < FIT or abs(least) > INSIDE:
        return None
    return middle + least * length, way


def _difference(rows: Floats) -> Valley | None:
    """Return the gap between sweeps up and down; None if they are too few.

    Args:
        rows: place of the least reading, and way (sweeps x 2).
    """
    up, down = (rows[rows[:, 1] == way, 0] for way in (1.0, -1.0))
    if min(up.size, down.size) < 1 or len(rows) < SWEEPS:
        return None
    squares = sum(float(np.sum((one - one.mean()) ** 2)) for one in (up, down))
    degrees = len(rows) - 2
    error = math.sqrt(squares / degrees * (1 / up.size + 1 / down.size))
    gap = float(up.mean() - down.mean())
    return Valley(Interval.from_half_width(gap, student_quantile(degrees) * error), len(rows))
