"""Does the input answer to the readings? A loop shows in the change of u at a tick itself."""

from __future__ import annotations

import numpy as np
from scipy.stats import f as fisher

from undeadzone.support.arrays import Flags, Floats

LAGS = 10  # samples of the past that are taken out
OWN = 3  # changes of readings, of now and before, to which u may answer
OUTLIER = 5.0  # scatters of what the past leaves: steps of a reference are none of the loop's
NORMAL = 1.4826  # standard deviation of a Gaussian by its median deviation
LEAST = 3e-3  # of du, that the past must leave
SHARE = 0.01  # of what it leaves, that readings must explain
CHANCE = 1e-6  # p from which a loop is closed
STILL = 0.5  # share of changes that are 0, from which u is a list of steps


def loop_chance(u: Floats, y: Floats) -> float:
    """p of what changes of y that came just before explain of changes of u, if there is no loop.

    1 where they explain hardly anything, or nothing can be told.

    Args:
        u: inputs (N).
        y: readings (N).
    """
    du, dy = np.diff(u), np.diff(y)
    rows = np.arange(LAGS, du.size)
    if rows.size < 10 * LAGS or np.mean(du == 0) > STILL:
        return 1.0
    now = np.column_stack([dy[rows - lag] for lag in range(OWN)])
    past = [du[rows - lag] for lag in range(1, LAGS + 1)]
    past += [dy[rows - lag] for lag in range(OWN, LAGS)]
    known = np.column_stack([np.ones(rows.size), *past])
    target = du[rows]
    kept = _usual(known, target)
    known, now, target = known[kept], now[kept], target[kept]
    before = _left(known, target)
    if np.std(before) < LEAST * np.std(target):
        return 1.0
    after = _left(np.column_stack([known, now]), target)
    share = 1 - float(after @ after) / float(before @ before)
    degrees = target.size - known.shape[1] - OWN
    ratio = share / max(1 - share, 1e-12) * degrees / OWN
    return float(fisher.sf(ratio, OWN, degrees)) if share > SHARE else 1.0


def _left(columns: Floats, target: Floats) -> Floats:
    """What columns leave of a target (n)."""
    return np.asarray(target - columns @ np.linalg.lstsq(columns, target, rcond=1e-10)[0])


def _usual(columns: Floats, target: Floats) -> Flags:
    """The rows without outliers (n)."""
    kept = np.ones(target.size, bool)
    for _ in range(3):
        slopes = np.linalg.lstsq(columns[kept], target[kept], rcond=1e-10)[0]
        left = np.abs(target - columns @ slopes)
        kept = left <= OUTLIER * NORMAL * float(np.median(left))
    return kept
