"""Free play under a load that flips: one goal, at which a position rests in two places.

No command cures it, since the load and not the goal decides at which flank the axis rests.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Flags, Floats
from undeadzone_identify.logs.grid import printed_step
from undeadzone_identify.models.estimates import Interval, student_quantile
from undeadzone_identify.models.lost_motion import HELD

QUIET = 2.5  # change of a still reading, at most [rms of its noise]
PAUSE = 3.0  # time between two samples, beyond which the first says nothing of the second [steps]
FEWEST = 30  # still samples at a goal
LEAST = 8  # of them at either rest
FLIPS = 4  # changes from one rest to the other, from which there is free play
SURE = 8  # flips, from which it is measured
APART = 3.2  # distance of the rests, at least [rms of their noise]
STEPS = 3.0  # distance of the rests, at least [steps of the reading]
EDGE = 0.1  # share of the samples at either rest, at least
BETWEEN = 0.1  # share of the samples between the rests, at most
MIDDLE = 0.4  # part of the way from one rest to the other, where "between" begins
TAIL = 0.1  # share of a rest's samples beyond its outermost readings
WIDE = 4.0  # width of a rest without its tails, up to which it is noise [rms]


class FreePlay(NamedTuple):
    """Distance of the two rests of a position at one goal.

    Attributes:
        play: with its 95 % interval [y]; it reaches to the outermost rests if these are not sharp.
        flips: changes from one rest to the other at an unchanged goal.
        is_sharp: whether both rests are as narrow as the noise.
        goal: at which the rests are [u].
        samples: still samples at it.
    """

    play: Interval
    flips: int
    is_sharp: bool
    goal: float
    samples: int

    @property
    def is_measured(self) -> bool:
        """Return whether flips and rests suffice for a number without doubt."""
        return self.is_sharp and self.flips >= SURE


def free_play_between_rests(t: Floats, u: Floats, y: Floats) -> FreePlay | None:
    """Return the free play of a position that rests in two places at one goal, else None.

    Args:
        t: times (N), increasing.
        u: goal (N).
        y: position (N).
    """
    there = np.isfinite(t) & np.isfinite(u) & np.isfinite(y)
    t, u, y = t[there], u[there], y[there]
    if y.size < FEWEST or np.mean(np.diff(u) == 0) < HELD:
        return None
    step = printed_step(y)
    curvature = np.median(np.abs(np.diff(y, 2)))
    noise = math.hypot(float(curvature) / 0.6745 / math.sqrt(6), step / math.sqrt(12))
    still = _still_samples(t, u, y, QUIET * noise)
    goals, counts = np.unique(u[still], return_counts=True)
    enough = goals[counts >= FEWEST]
    holds = np.cumsum(np.diff(u, prepend=u[0]) != 0)
    found = [_two_rests(goal, y, holds, still & (u == goal), (noise, step)) for goal in enough]
    return max(filter(None, found), key=lambda one: one.flips, default=None)


def _still_samples(t: Floats, u: Floats, y: Floats, most: float) -> Flags:
    """Return the samples that neither goal nor position enters or leaves by a move (N)."""
    near = np.diff(t) < PAUSE * np.median(np.diff(t))
    rests = near & (np.diff(u) == 0) & (np.abs(np.diff(y)) <= most)
    return np.append(False, rests) & np.append(rests, False)


def _two_rests(
    goal: float, y: Floats, holds: Floats, here: Flags, resolution: tuple[float, float]
) -> FreePlay | None:
    """Return the free play at one goal, None if its still samples are not two clusters.

    Args:
        goal: the goal [u].
        y: position (N).
        holds: number of the hold of each sample (N).
        here: still samples at the goal (N).
        resolution: rms of the noise, and step of the reading [y].
    """
    noise, step = resolution
    ordered = np.sort(y[here])
    few = max(LEAST, math.ceil(EDGE * ordered.size))
    inner = np.diff(ordered)[few - 1 : -(few - 1)]
    cut = few + int(np.argmax(inner))
    low, high = ordered[:cut], ordered[cut:]
    rests = np.array([np.median(low), np.median(high)])
    apart = float(np.ptp(rests))
    spread = max(float(low.std()), float(high.std()), noise)
    border = rests.mean()
    side = y[here] > border
    flips = int(np.sum((np.diff(side) != 0) & (np.diff(holds[here]) == 0)))
    between = float(np.mean(np.abs(ordered - border) < (0.5 - MIDDLE) * apart))
    if flips < FLIPS or apart <= max(APART * spread, STEPS * step) or between > BETWEEN:
        return None
    outer = float(np.quantile(high, 1 - TAIL) - np.quantile(low, TAIL))
    widths = [float(np.quantile(one, 1 - TAIL) - np.quantile(one, TAIL)) for one in (low, high)]
    is_sharp = max(widths) <= WIDE * noise
    error = math.hypot(math.sqrt(2 / (flips + 1)) * spread, step / math.sqrt(6))
    half = student_quantile(flips - 1.0) * error
    top = apart if is_sharp else max(apart, outer)
    return FreePlay(
        Interval(apart, apart - half, top + half), flips, is_sharp, float(goal), ordered.size
    )
