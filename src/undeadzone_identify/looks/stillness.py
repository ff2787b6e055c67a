"""The witness of stillness: how far the command travelled while the reading stood still.

A stretch counts if the reading enters and leaves it in one direction. No limit of a dead band
and no null may be below its travel, whatever a model says. A reading that stands at its largest or
least value for longer than at its other turning points ends there.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import mannwhitneyu

from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.grid import find_quantum
from undeadzone_identify.looks.rows import known_samples, noise_of
from undeadzone_identify.models.estimates import Interval

MOST = 20_000  # samples that are looked at; a longer record is thinned
LATEST = 60  # samples by which a reading may lag
SHORTEST = 6  # samples of a stretch
BLUR, TOO_NOISY = 3.0, 0.05  # noise about a level; share of the range that hides all rest
BESIDE = 2.5  # tolerances, by which the reading moves before and after
STEP = 0.25  # of the travel: a single change of the command that is left out
CHANCE = 0.01  # of longer stays at an end of the readings than at their other turns


def longest_stillness(t: Floats | None, u: Floats, y: Floats) -> float:
    """Return the largest travel of the command during a rest of the reading; 0 without one [u].

    The largest step of the command, and what the lag of the reading explains, do not count.

    Args:
        t: times (N); None for samples in the order of their record.
        u: commands (N).
        y: readings, some may be missing (N).
    """
    _, u, y = known_samples(t, u, y)
    u, y = (signal[:: 1 + u.size // MOST] for signal in (u, y))
    if u.size < 4 * SHORTEST:
        return 0.0
    blur = max(BLUR * noise_of(y), 1.01 * find_quantum(y), 1e-9 * float(np.ptp(y)))
    if not 0 < blur < TOO_NOISY * np.ptp(y):
        return 0.0
    lag = _find_lag(u, y)
    longest = 0.0
    for first, end in _stretches(y, 2 * blur, SHORTEST + lag):
        level = float(np.median(y[first:end]))
        before = level - y[max(first - SHORTEST, 0)]
        after = y[min(end + SHORTEST, y.size - 1)] - level
        change = np.abs(np.diff(u[first : end - lag]))
        travel = abs(float(u[end - lag - 1] - u[first]))
        largest = float(change.max(initial=0.0))
        goes_on = before * after > 0 and min(abs(before), abs(after)) > BESIDE * blur
        if goes_on and change.sum() < 1.2 * travel:
            longest = max(longest, travel - largest * (largest > STEP * travel))
    return longest


def ends_of_readings(t: Floats | None, u: Floats, y: Floats) -> dict[str, Interval]:
    """Return the upper and lower limit of the readings, each if they stop there [y].

    Their stays at that exact value are compared with those at all other turning points: a smooth
    signal, play and friction stay as long at each. The commands move meanwhile. The end that is
    nearer to 0, on its side, may be a rest.

    Args:
        t: times (N); None for samples in the order of their record.
        u: commands (N).
        y: readings, some may be missing (N).

    References:
        H. B. Mann, D. R. Whitney (1947), doi:10.1214/aoms/1177730491
    """
    _, u, y = known_samples(t, u, y)
    found = {}
    for name, way in (("upper", 1), ("lower", -1)):
        level, stays = _turns_with_stays(way * y)
        top = max(float(np.max(way * y)), 0.0)
        there, others = stays[level == top], stays[level < top]
        if min(there.size, others.size, top) == 0:
            continue
        chance = mannwhitneyu(there, others, alternative="greater").pvalue
        end = way * top
        if chance < CHANCE and np.ptp(u[y == end]) > STEP * np.ptp(u):
            found[name] = Interval(end, end, end)
    return found


def _turns_with_stays(y: Floats) -> tuple[Floats, Floats]:
    """Return the levels of all upper turning points, and the samples that a reading stays there."""
    cut = np.flatnonzero(np.diff(y, prepend=np.nan, append=np.nan))
    level = y[cut[:-1]]
    before, at, after = level[:-2], level[1:-1], level[2:]
    turns = (at > before) & (at > after)
    stays = np.diff(cut)[1:-1]
    return at[turns], stays[turns]


def _find_lag(u: Floats, y: Floats) -> int:
    """Return the lag of the reading's changes behind the command's [samples]."""
    ahead, behind = (np.diff(signal) - np.mean(np.diff(signal)) for signal in (u, y))
    most = min(LATEST, u.size // 8)
    return int(np.argmax([abs(ahead[: ahead.size - k] @ behind[k:]) for k in range(most)]))


def _stretches(y: Floats, most: float, least: int) -> list[tuple[int, int]]:
    """Return the stretches, from left to right, in which a reading's range is so small."""
    found = []
    first, low, high = 0, y[0], y[0]
    for k, value in enumerate([*y.tolist(), np.inf]):
        low, high = min(low, value), max(high, value)
        if high - low > most:
            if k - first >= least:
                found.append((first, k))
            first, low, high = k, value, value
    return found
