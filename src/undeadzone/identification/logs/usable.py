"""Which readings of a log count: no spikes, no dropouts, none that is stuck or at a range's end."""

from __future__ import annotations

import numpy as np

from undeadzone.identification.logs.grid import Grid
from undeadzone.logs.range_ends import RangeEnds, range_ends
from undeadzone.support.arrays import Flags, Floats, runs

SPIKE = 10.0  # times the 99 % quantile of |y|, beyond which few readings are no readings
RARE = 0.005  # share of the readings that may be dropped as spikes
LOUD = 2.0  # times the largest usual step, by which readings beside a dropout are beyond silence
FAST = 0.005  # share of the steps between speaking readings that may be larger than usual
DROPPED = 0.1  # share of the readings that may be dropouts
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
    if not ends.found or max(_visits(at & (grid.y > 0)), _visits(at & (grid.y < 0))) < VISITS:
        return ok, RangeEnds(-np.inf, np.inf, 0)
    remarks.append(
        f"{ends.number} readings stick at the ends of the range {ends.text}: there they "
        "only bound the output, and are taken as missing"
    )
    return ok & ~at, ends


def _visits(at: Flags) -> int:
    """How many times readings come to an end of their range."""
    return int(runs(at)[0].size)


def _spikes(grid: Grid, remarks: list[str]) -> Flags:
    """The few readings far beyond all others (N): one would rule every sum."""
    size = np.abs(grid.y)
    usual = float(np.quantile(size[grid.ok], 0.99))
    spikes = grid.ok & (size > SPIKE * usual)
    if usual == 0.0 or not 0 < spikes.sum() <= max(1, RARE * grid.ok.sum()):
        return np.zeros_like(spikes)
    remarks.append(
        f"{spikes.sum()} readings beyond {SPIKE:g} times the usual size are taken as missing,"
        f" the first at {grid.t[spikes][0]:.6g} s"
    )
    return spikes


def _dropouts(grid: Grid, ok: Flags, remarks: list[str]) -> Flags:
    """Zeros between two readings so loud that no output gets from them to silence in a step (N).

    The least reading of a jump sensor is its edge, from which it does fall to 0; so what counts is
    how far the readings are beyond the least one of their side.
    """
    y, speaks = grid.y, ok & (grid.y != 0)
    dropped = np.zeros_like(ok)
    steps = np.abs(np.diff(y))[speaks[1:] & speaks[:-1] & (y[1:] * y[:-1] > 0)]
    if steps.size < 1 / FAST:
        return dropped
    beyond = np.zeros(y.size)
    for side in (y > 0, y < 0):
        beyond += np.where(side, np.abs(y) - np.abs(y[speaks & side]).min(initial=np.inf), 0.0)
    loud = speaks & (beyond > LOUD * float(np.quantile(steps, 1 - FAST)))
    for first, last in zip(*runs(ok & ~speaks), strict=True):
        inside = first > 0 and last + 1 < y.size
        if inside and loud[first - 1] and loud[last + 1] and y[first - 1] * y[last + 1] > 0:
            dropped[first : last + 1] = True
    if not 0 < dropped.sum() <= DROPPED * ok.sum():
        return np.zeros_like(ok)
    remarks.append(
        f"{dropped.sum()} zeros between two loud readings of one sign are dropouts, and taken as"
        f" missing, the first at {grid.t[dropped][0]:.6g} s"
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
    moves = _moved(grid.u[part]) > MOVING * _moved(grid.u)
    least = max(STUCK * ok.sum(), LONGER * second)
    if not least <= lengths[longest] < ok.sum() / 2 or not moves.any():
        return stuck
    stuck[part] = True
    remarks.append(
        f"the reading is stuck at {grid.y[part.start]:.6g} for {stuck.sum()} samples from"
        f" {grid.t[part.start]:.6g} s on, while the input moves: taken as missing"
    )
    return stuck


def _moved(u: Floats) -> Floats:
    """By how much each input moves (m)."""
    return np.asarray(u.std(axis=0))
