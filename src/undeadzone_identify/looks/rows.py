"""Rows at rest: commands with their readings, from a table, from holds, or from a slow sweep."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from undeadzone.logs.kinds import TABLE
from undeadzone.logs.names import PAST
from undeadzone.util.arrays import Flags, Floats, Integers, split_past, turns
from undeadzone_identify.logs.grid import find_quantum
from undeadzone_identify.models.motion import white_noise_rms

LEVELS = 5  # least number of different commands: those of level, edge, slope and bend, and one
HOLD = 6  # samples in a row at one command, from which it is held
SLOW = 0.03  # of the reading's range: its median spread at one command, in a slow sweep
SETTLED = 0.004  # of the reading's spread, by which the last quarter of a hold may still move
FASTER = 0.7  # of the quarter before, by which the last quarter of a hold moves at most
STEP = 0.3  # of the commands' range, from which a change is a step of a sweep
PARTS = 60  # of the rows in the order of their commands, in each of which a map is a line
COMING = 0.15  # of the reading's spread, by which it moves at most


class Rows(NamedTuple):
    """Readings at rest.

    Attributes:
        u: commands (R).
        y: readings (R).
        came: sign of the last change of the command, 0 for none (R).
        how: "table", "holds", "sweep", "ways" of a sweep whose way up lies beside its way down, or
            "cloud", whose readings scatter but tell nothing of earlier commands.
    """

    u: Floats
    y: Floats
    came: Floats
    how: str


def rows_at_rest(t: Floats | None, u: Floats, y: Floats, levels: int = LEVELS) -> Rows | None:
    """Return the rows at rest of a log; None where readings move by themselves.

    Args:
        t: times, in any order (N); None for rows in the order of their record.
        u: commands (N).
        y: readings, some may be missing (N).
        levels: least number of different commands.
    """
    is_table = t is None
    u, y = known_samples(t, u, y)[1:]
    if np.unique(u).size < levels or np.ptp(y) == 0:
        return None
    leaps = np.abs(np.diff(u)) > STEP * np.ptp(u)
    sweeps = np.split(u, np.flatnonzero(leaps) + 1)
    repeats = len(sweeps) > 1 and min(np.unique(one).size for one in sweeps) >= levels
    one_way = np.ptp(np.sign(np.diff(u)[~leaps])) < 2  # the same sweep again and again
    if is_table and (u.size < TABLE or (repeats and one_way)):
        return Rows(u, y, last_changes(u), "table")
    cut = np.flatnonzero(np.diff(u, prepend=np.nan, append=np.nan))
    length = np.diff(cut)
    came = last_changes(u)
    if length[length >= HOLD].sum() >= u.size / 2:
        return _settled_rows(u, y, came, cut, levels) or _sweep_rows(u, y, came)
    if u.size < TABLE:
        return Rows(u, y, came, "table")
    return _sweep_rows(u, y, came)


def known_samples(t: Floats | None, u: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the samples without a missing number, in the order of time."""
    u, y = np.asarray(u, float), np.asarray(y, float)
    t = np.arange(u.size, dtype=float) if t is None else np.asarray(t, float)
    order = np.argsort(t, kind="stable")
    order = order[np.isfinite(t + u + y)[order]]
    return t[order], u[order], y[order]


def last_changes(u: Floats) -> Floats:
    """Return the sign of the last change up to each sample, 0 before the first (N)."""
    change = np.sign(np.diff(u, prepend=u[:1]))
    last = np.maximum.accumulate(np.where(change != 0, np.arange(u.size), 0))
    return np.asarray(change[last])


def noise_of(y: Floats) -> float:
    """Return the rms of a reading's noise with that of its rounding [y]."""
    if y.size < LEVELS:
        return 0.0
    white = white_noise_rms(y, np.ones(y.size, bool), np.zeros(1, int))
    return math.hypot(white, find_quantum(y) / math.sqrt(12))


def _settled_rows(u: Floats, y: Floats, came: Floats, cut: Integers, levels: int) -> Rows | None:
    """Return a row of each hold that comes to rest.

    The last quarter of such a hold reads what the quarter before it read. If few holds do, those
    count too that come near to rest like a plant of first order, whose last value is known then.
    """
    noise, still = noise_of(y), SETTLED * float(np.std(y))
    rows, coming = [], []
    held = [(a, b) for a, b in itertools.pairwise(cut) if b - a >= HOLD]
    for a, b in held:
        quarter = (b - a) // 4 + 1
        first, before, late = (
            y[max(b - k * quarter, a) : b - (k - 1) * quarter] for k in (3, 2, 1)
        )
        moved = late.mean() - before.mean()
        earlier = before.mean() - first.mean()
        error = noise * math.sqrt(1 / late.size + 1 / before.size)
        row = [u[a], np.median(late), came[a]]
        if abs(moved) < 3 * error + still:
            rows.append(row)
            coming.append(row)
        elif 0 < moved * np.sign(earlier) < min(FASTER * abs(earlier), COMING * np.std(y)):
            rest = moved / (earlier / moved - 1)
            coming.append([u[a], late.mean() + rest, came[a]])
    rows = rows if len(rows) >= max(LEVELS, len(held) / 2) else coming
    if len(rows) < max(LEVELS, len(held) / 2):
        return None
    u, y, came = np.array(rows).T
    if np.unique(u).size < levels or np.ptp(y) == 0:
        return None
    return Rows(u, y, came, "holds")


def _sweep_rows(u: Floats, y: Floats, came: Floats) -> Rows | None:
    """Return all samples if the readings at one command differ little, whenever they were taken.

    The way up may lie beside the way down. A single way between two long stays is a step.
    """
    at_ends = np.abs(u - (u.min() + u.max()) / 2) > (0.5 - SLOW) * np.ptp(u)
    if at_ends.mean() > 0.5 and not turns(u, float(np.ptp(u)) / 2).size:
        return None
    every = Rows(u, y, came, "cloud")
    u, rests = _follow_steps(u, y)
    u, y, came = u[rests], y[rests], came[rests]
    order = np.argsort(u, kind="stable")
    ways = [order[came[order] >= 0], order[came[order] < 0]]
    for how, some in (("sweep", [order]), ("ways", ways)):
        spread = np.concatenate([_spread_at_commands(y[one]) for one in some]) / _range(y[order])
        if np.median(spread) < SLOW:
            return Rows(u, y, came, how)
    return every if _has_no_memory(every.u, every.y) else None


def _has_no_memory(u: Floats, y: Floats) -> bool:
    """Return whether readings depend on their commands, and hardly on earlier ones.

    Medians by command explain more than they leave, and what they leave is regressed on what the
    commands were before.
    """
    explained = _medians_along(u, y)
    left = y - explained
    now, *past = split_past(u[:, None], PAST)
    if np.var(left) > np.var(explained) or not past:
        return False
    design = np.hstack([np.ones(now.shape), *(one - now for one in past)])
    coefficients = np.linalg.lstsq(design, left[-now.size :], rcond=None)[0]
    late = float(np.std(design @ coefficients))
    return late < SLOW * _range(y[np.argsort(u, kind="stable")])


def _medians_along(u: Floats, y: Floats) -> Floats:
    """Return the medians of readings at the commands of all samples (N)."""
    limits = np.unique(np.quantile(u, np.linspace(0, 1, PARTS + 1)))
    part = np.searchsorted(limits[1:-1], u)
    there = [part == k for k in np.unique(part)]
    x = [np.median(u[one]) for one in there]
    v = [np.median(y[one]) for one in there]
    return np.interp(u, x, v)


def _follow_steps(u: Floats, y: Floats) -> tuple[Floats, Flags]:
    """Return the commands that the rows of a sweep answer, and which rows follow no step (N).

    After a step the reading moves on in the direction of its first change. Noise ends that early,
    so that as many rows again are left out. The area below the answer over its height is the lag of
    a sweep's readings, in rows.
    """
    follows = np.zeros(u.size, bool)
    lags = [0.0]
    steps = np.flatnonzero(np.abs(np.diff(u)) > STEP * np.ptp(u)).tolist()
    for k, end in itertools.pairwise([*steps, u.size - 1]):
        change = np.append(np.diff(y[k : end + 1]), 0.0)
        answer = y[k : k + 1 + 2 * int(np.argmin(change * change[0] > 0))]
        follows[k + 1 : k + answer.size] = True
        lags.append(float(np.sum(answer[1:] - answer[-1])) / (answer[0] - answer[-1] or np.inf))
    rows = np.arange(u.size)
    return np.interp(rows - np.mean(lags[1:] or lags), rows, u), ~follows


def _spread_at_commands(y: Floats) -> Floats:
    """Return the deviations of neighbours from lines, of readings in the order of the command."""
    size = max(4, y.size // PARTS)
    bends = np.diff(y[: y.size // size * size].reshape(-1, size), 2, axis=1)
    return np.sqrt(np.mean(bends**2, axis=1) / 6)


def _range(y: Floats) -> float:
    """Return the range of readings in the order of the command, without outliers."""
    return float(np.ptp(np.median(y[: y.size // 8 * 8].reshape(-1, 8), axis=1))) or np.inf
