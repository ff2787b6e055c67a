"""Free play under a load that flips: a position that rests in two places at the same goal.

No command cures it, since the load and not the goal decides at which flank the axis rests.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats, Integers
from undeadzone_identify.logs.grid import printed_step
from undeadzone_identify.looks.rows import known_samples, noise_of
from undeadzone_identify.models.estimates import Interval, student_quantile
from undeadzone_identify.models.lost_motion import HELD

QUIET = 2.5  # change of a still reading, at most [rms of its noise]
PAUSE = 3.0  # time between two samples, beyond which the first says nothing of the second [steps]
FEWEST = 30  # still samples at a goal
LEAST = 8  # of them at either rest
FLIPS = 4  # changes from one rest to the other, from which there is free play
APART = 3.2  # distance of the rests, at least [rms of their noise]
STEPS = 3.0  # distance of the rests, at least [steps of the reading]
EDGE = 0.1  # share of the samples at either rest, at least
BETWEEN = 0.1  # share of the samples between the rests, at most
MIDDLE = 0.1  # of the distance of the rests, up to which from its middle is "between"
TAIL = 0.1  # share of a rest's samples beyond its outermost readings
WIDE = 4.0  # width of a rest without its tails, up to which it is noise [rms]


class FreePlay(NamedTuple):
    """Distance of the two rests of a position at one goal.

    Attributes:
        play: with its 95 % interval [y]; it reaches to the outermost rests if these are not sharp.
        flips: changes from one rest to the other at an unchanged goal.
        is_measured: whether both rests are as narrow as the noise.
        goal: at which the rests are [u].
    """

    play: Interval
    flips: int
    is_measured: bool
    goal: float


def free_play_between_rests(t: Floats, u: Floats, y: Floats) -> FreePlay | None:
    """Return the free play of a position that rests in two places at the same goal, or None.

    Args:
        t: times (N).
        u: goal (N).
        y: position, some may be missing (N).
    """
    t, u, y = known_samples(t, u, y)
    if y.size < FEWEST or np.mean(np.diff(u) == 0) < HELD:
        return None
    noise = noise_of(y)
    near = np.diff(t) < PAUSE * np.median(np.diff(t))
    rests = near & (np.diff(u) == 0) & (np.abs(np.diff(y)) <= QUIET * noise)
    still = np.append(False, rests) & np.append(rests, False)
    hold = np.cumsum(np.diff(u, prepend=u[0]) != 0)
    goals, counts = np.unique(u[still], return_counts=True)
    found = []
    for goal in goals[counts >= FEWEST]:
        here = still & (u == goal)
        found.append(_two_rests(float(goal), y[here], hold[here], noise))
    return max(filter(None, found), key=lambda one: one.flips, default=None)


def _two_rests(goal: float, y: Floats, hold: Integers, noise: float) -> FreePlay | None:
    """Return the free play at one goal, None if its still samples are not two clusters.

    Args:
        goal: the goal [u].
        y: still samples at it (N).
        hold: number of the hold of each (N).
        noise: rms of the reading's noise and rounding [y].
    """
    step = printed_step(y)
    ordered = np.sort(y)
    few = max(LEAST, math.ceil(EDGE * y.size))
    cut = few + int(np.argmax(np.diff(ordered)[few - 1 : -(few - 1)]))
    both = ordered[:cut], ordered[cut:]
    low, high = (float(np.median(one)) for one in both)
    apart = high - low
    spread = max(noise, *(float(one.std()) for one in both))
    part = (y - low) / max(apart, 1e-300)
    flips = int(np.sum((np.diff(part > 0.5) != 0) & (np.diff(hold) == 0)))
    between = np.mean(np.abs(part - 0.5) < MIDDLE)
    if flips < FLIPS or apart <= max(APART * spread, STEPS * step) or between > BETWEEN:
        return None
    ends = np.array([np.quantile(one, (TAIL, 1 - TAIL)) for one in both])
    is_sharp = bool(np.ptp(ends, axis=1).max() <= WIDE * noise)
    error = math.hypot(spread * math.sqrt(2 / (flips + 1)), step / math.sqrt(6))
    half = student_quantile(flips - 1.0) * error
    widest = apart if is_sharp else float(np.ptp(ends))
    play = Interval(apart, apart - half, widest + half)
    return FreePlay(play, flips, is_sharp, goal)
