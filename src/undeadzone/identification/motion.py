"""What readings say of the motion behind them: the side of a play, before any model is asked.

Three rules, by what the sensor promises (docs/play.md): of exact readings the sign of their change,
of an encoder its ticks, of noisy readings the slope of those before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.identification.log import Flags
from undeadzone.support.arrays import Floats, Integers

SURE = 5.5  # standard deviations of a slope: one false side in a gap's log ruins its estimate
WINDOWS = (4, 6, 8, 12, 16, 24, 32)
HELD = 0.01  # share of readings equal to the one before that shows a sensor without noise
CHATTER = 0.02  # share of ticks that are taken back at once, from which ticks are noise


class Sensing(NamedTuple):
    """How readings show motion.

    Attributes:
        noise: rms of their white noise [y]; 0 of exact readings and of an encoder.
        quantum: of an encoder [y]; 0 of other readings.
        window: readings over which a slope is taken; 1 where each change counts.
    """

    noise: float
    quantum: float
    window: int


def sensing(y: Floats, ok: Flags, start: Integers, quantum: float) -> Sensing:
    """How the readings of a log show motion.

    Args:
        y: readings (N).
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        quantum: smallest common spacing of the readings, 0 if there is none.

    Returns:
        The rule; of noisy readings with the window that makes out most sides.
    """
    change, known = _changes(y, ok, start)
    if (change[known] == 0).mean() > HELD and not _chatters(change[known]):
        return Sensing(0.0, quantum, 1)
    rms = float(np.hypot(white_noise(y, ok, start), quantum / np.sqrt(12)))
    counts = []
    for window in WINDOWS:
        counts.append(np.count_nonzero(sides(y, ok, start, Sensing(rms, 0.0, window))))
    return Sensing(rms, 0.0, WINDOWS[int(np.argmax(counts))])


def sides(y: Floats, ok: Flags, start: Integers, how: Sensing) -> Integers:
    """+1 where the readings move right for sure, -1 left, 0 where nothing is sure (N).

    Args:
        y: readings (N).
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        how: the rule.
    """
    if how.noise:
        moved = moved_before(y, ok, start, how.window)
        least = SURE * how.noise * np.sqrt(12 / how.window)
    else:
        change, known = _changes(y, ok, start)
        moved = np.where(known, change, 0.0)
        least = how.quantum / 2
    return ok * (1 * (moved > least) - 1 * (moved < -least))


def moved_before(y: Floats, ok: Flags, start: Integers, window: int) -> Floats:
    """Slope of the `window` readings before each one times the window (N); 0 where unknown."""
    weights = np.arange(window) - (window - 1) / 2
    weights *= window / (weights @ weights)
    slope = np.convolve(np.where(ok, y, 0.0), weights[::-1])[: y.size]
    whole = np.convolve(1.0 * ok, np.ones(window))[: y.size] > window - 0.5
    begun = np.zeros(y.size, int)
    begun[start] = start
    own = np.arange(y.size) - np.maximum.accumulate(begun) >= window - 1
    moved = np.zeros(y.size)
    moved[1:] = (slope * (whole & own))[:-1]
    moved[start] = 0.0
    return moved


def white_noise(y: Floats, ok: Flags, start: Integers) -> float:
    """rms of the white noise of readings, by the median of their third differences."""
    known = ok.copy()
    difference = y
    for _ in range(3):
        difference = np.append(0.0, np.diff(difference))
        known = known & np.append(False, known[:-1])
    for first in start:
        known[first : first + 3] = False
    if not known.any():
        return 0.0
    return float(np.median(np.abs(difference[known])) / 0.6745 / np.sqrt(20))


def _changes(y: Floats, ok: Flags, start: Integers) -> tuple[Floats, Flags]:
    """Changes from the reading before (N), and where they are known (N)."""
    change = np.append(0.0, np.diff(y))
    known = ok & np.append(False, ok[:-1])
    known[start] = False
    return change, known


def _chatters(change: Floats) -> bool:
    """Whether many changes are taken back by the next one: noise about a boundary."""
    ticks = change[change != 0]
    if ticks.size < 10:
        return False
    return float((ticks[1:] == -ticks[:-1]).mean()) > CHATTER
