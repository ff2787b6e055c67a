"""Changes of readings from sample to sample, and the white noise in them."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from undeadzone.util.arrays import Flags, Floats, Integers, rows_since_start

REPEATED_SHARE = 0.01  # share of readings equal to the one before that shows a sensor without noise
CHATTER = 0.05  # share of ticks that the next tick undoes, above which ticks are noise
REVERSED_SHARE = 0.35  # share of ticks that a reversed tick follows, above which ticks are noise


def are_exact(y: Floats, ok: Flags, start: Integers) -> bool:
    """Return whether readings are exact, or those of an encoder: they repeat, and do not chatter.

    Args:
        y: readings (N).
        ok: flags of the readings that are not missing (N).
        start: first sample of each record (R).
    """
    change, known = reading_changes(y, ok, start)
    active = change[known & (y != 0)]
    repeats = active.size > 0 and bool((active == 0).mean() > REPEATED_SHARE)
    return repeats and not _has_chatter(np.where(known, change, 0.0))


def white_noise_rms(y: Floats, ok: Flags, start: Integers) -> float:
    """Return the rms of the white noise of readings [y], by the median of third differences.

    A third difference removes motion; its variance is 20 times that of white noise. The median of
    absolute values of a Gaussian is 0.6745 standard deviations.
    """
    known = ok & (y != 0)  # readings inside a zone have no noise
    known = sliding_window_view(known, 4).all(axis=1)
    known &= rows_since_start(start, y.size)[3:] >= 3
    if not known.any():
        return 0.0
    return float(np.median(np.abs(np.diff(y, 3)[known])) / 0.6745 / np.sqrt(20))


def reading_changes(y: Floats, ok: Flags, start: Integers) -> tuple[Floats, Flags]:
    """Return changes from the previous reading (N), and flags of the known changes (N)."""
    change = np.append(0.0, np.diff(y))
    known = ok & np.append(False, ok[:-1])
    known[start] = False
    return change, known


def _has_chatter(change: Floats) -> bool:
    """Return whether many ticks reverse within two samples, as noise at a boundary makes them.

    Args:
        change: changes of the readings, 0 if unknown (N).
    """
    ticks = np.flatnonzero(change)
    if ticks.size < 10:
        return False
    tick = change[ticks[:-1]]
    following = change[ticks[1:]]
    reverses = (tick * following < 0) & (np.diff(ticks) <= 2)
    undone = (reverses & (tick == -following)).mean()
    return bool(undone > CHATTER or reverses.mean() > REVERSED_SHARE)


def last_reading_rows(ok: Flags) -> Integers:
    """Return the row of the last reading up to each row (N), the first one's before it.

    Args:
        ok: whether there is a reading (N).
    """
    return np.maximum.accumulate(np.where(ok, np.arange(ok.size), int(np.argmax(ok))))
