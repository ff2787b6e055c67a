"""Which readings of a log count: no spikes, no dropouts, none that is stuck or at a range's end."""

from __future__ import annotations

import numpy as np

from undeadzone.identification.logs.grid import SPIKE, Grid, spikes
from undeadzone.logs.range_ends import RangeEnds, range_ends
from undeadzone.support.arrays import Flags, runs

LOUD = 2.0  # times the steps beside it, by which readings beside a dropout are beyond silence
DROPPED = 0.1  # share of the readings that may be dropouts
LASTING = 0.01  # share of the readings that are silent in a row, from which there is a silence
STUCK = 0.05  # share of the readings that hold one value, from which a sensor may be stuck
LONGER = 5.0  # times the second longest hold
MOVING = 0.3  # of its rms, by which the input moves meanwhile
VISITS = 3  # of an end of the range, in a log that sticks there


def usable(grid: Grid, remarks: list[str]) -> tuple[Flags, RangeEnds]:
    """Which readings count (N), and where they stick.

    Args:
        grid: the log on its grid.
        remarks: what is left out is added here, for the user.
    """
    ok = grid.ok & ~_spikes(grid, remarks)
    ok &= ~_dropouts(grid, ok, remarks)
    ok &= ~_stuck(grid, ok, remarks)
    ends = range_ends(grid.y, ok, grid.quantum)
    at = ends.at(grid.y, ok)
    visits = [runs(at & side)[0].size for side in (grid.y > 0, grid.y < 0)]
    if not ends.found or max(visits) < VISITS:
        return ok, RangeEnds(-np.inf, np.inf, 0)
    remarks.append(
        f"{ends.number} readings stick at the ends of the range {ends.text}: there they "
        "only bound the output, and are taken as missing"
    )
    return ok & ~at, ends


def _spikes(grid: Grid, remarks: list[str]) -> Flags:
    """The few readings far beyond all others (N)."""
    found = spikes(grid.y, grid.ok)
    if found.any():
        remarks.append(
            f"{found.sum()} readings beyond {SPIKE:g} times the usual size are taken as missing,"
            f" the first at {grid.t[found][0]:.6g} s"
        )
    return found


def _dropouts(grid: Grid, ok: Flags, remarks: list[str]) -> Flags:
    """Zeros between two readings so loud that no output falls silent from there (N).

    It would have to move in a step by much more than it does before and after. A jump sensor falls
    silent from its edge, its least reading; so what counts is how far readings are beyond that.
    Where no silence lasts, noise leaves no reading at 0 exactly: there every lonely zero is one.
    """
    y, speaks = grid.y, ok & (grid.y != 0)
    beyond, step = np.zeros(y.size), np.zeros(y.size + 1)
    for side in (speaks & (y > 0), speaks & (y < 0)):
        beyond += np.where(side, np.abs(y) - np.abs(y[side]).min(initial=np.inf), 0.0)
        step[1:-1] += np.where(side[1:] & side[:-1], np.abs(np.diff(y)), 0.0)
    usual = float(np.median(step[step > 0])) if step.any() else np.inf
    dropped = np.zeros_like(ok)
    for first, last in zip(*runs(ok & ~speaks), strict=True):
        before, after = max(first - 1, 0), min(last + 1, y.size - 1)
        moved = max(usual, abs(y[after] - y[before]), step[before], step[after + 1])
        loud = min(beyond[before], beyond[after]) > LOUD * moved
        dropped[first : last + 1] = loud and y[before] * y[after] > 0
    silent = ok & ~speaks
    lasts = silent & (np.roll(silent, 1) | np.roll(silent, -1))
    if not grid.quantum and lasts.sum() <= LASTING * ok.sum():
        dropped |= silent & ~lasts
    if not 0 < dropped.sum() <= DROPPED * ok.sum():
        return np.zeros_like(ok)
    remarks.append(
        f"{dropped.sum()} zeros that no output explains are dropouts, and taken as missing, the"
        f" first at {grid.t[dropped][0]:.6g} s"
    )
    return dropped


def _stuck(grid: Grid, ok: Flags, remarks: list[str]) -> Flags:
    """A long hold of one reading, not 0, while the input goes on to move (N)."""
    held = np.append(False, (np.diff(grid.y) == 0) & ok[1:] & ok[:-1]) & (grid.y != 0)
    first, last = runs(held)
    stuck = np.zeros_like(ok)
    if not first.size:
        return stuck
    lengths = last - first + 1
    longest = int(np.argmax(lengths))
    second = float(np.delete(lengths, longest).max(initial=1.0))
    part = slice(int(first[longest]) - 1, int(last[longest]) + 1)
    moves = grid.u[part].std(axis=0) > MOVING * grid.u.std(axis=0)
    least = max(STUCK * ok.sum(), LONGER * second)
    if not least <= lengths[longest] < ok.sum() / 2 or not moves.any():
        return stuck
    stuck[part] = True
    remarks.append(
        f"the reading is stuck at {grid.y[part.start]:.6g} for {stuck.sum()} samples from"
        f" {grid.t[part.start]:.6g} s on, while the input moves: taken as missing"
    )
    return stuck
