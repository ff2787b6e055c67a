"""From a log on its grid to the data of a fit: what is silent, what is dropped, what refused."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.grid import Grid
from undeadzone.identification.jump_edges import JumpEdge, as_dead_zone
from undeadzone.identification.log import Flags
from undeadzone.identification.objective import Limits
from undeadzone.identification.options import Options
from undeadzone.identification.plant_fit import Data
from undeadzone.logs.range_ends import range_ends
from undeadzone.support.arrays import Floats, Integers

STRETCH = 250  # samples of an integrating plant that have one state at their start
PER_NUMBER = 50  # readings needed for each pole, and one more
ZEROS = 0.01  # share of silent readings that shows noise ahead of the zone
OFTEN = 5  # times the next reading's count, by which a silence comes back
SPIKE = 10.0  # times the 99 % quantile of |y|, beyond which few readings are no readings
RARE = 0.005  # share of the readings that may be dropped as spikes


class Prepared(NamedTuple):
    """A log made ready.

    Attributes:
        data: scaled records.
        limits: of the widths, scaled.
        orders: orders that the log is long enough for.
        threshold: |y| up to which a reading is silent [y].
        remarks: what was done, for the user.
        jumps: right and left edge of a jump sensor, scaled; None for a dead zone.
        ends: where readings stick, as a range of readings has it; empty: nowhere.
    """

    data: Data
    limits: Limits
    orders: list[int]
    threshold: float
    remarks: list[str]
    jumps: tuple[JumpEdge, JumpEdge] | None = None
    ends: str = ""


def prepare(grid: Grid, options: Options) -> Prepared:
    """The data of a fit.

    Args:
        grid: the log on its grid.
        options: what the user said.

    Returns:
        Data scaled to rms 1, limits of the widths, orders to try.

    Raises:
        InputError: a log from which nothing can be learnt: too short, a constant input, a reading
            that never changes or is silent throughout.
    """
    remarks = list(grid.remarks)
    ok = grid.ok.copy()
    _require_silence_at_zero(grid)
    spikes = _spikes(grid.y, ok)
    if spikes.size:
        ok[spikes] = False
        remarks.append(
            f"{spikes.size} readings beyond {SPIKE:g} times the usual size are taken as missing,"
            f" the first at {grid.t[spikes[0]]:.6g} s"
        )
    ends = range_ends(grid.y, ok, grid.quantum)
    if ends.found:
        ok &= ~ends.at(grid.y, ok)
        remarks.append(
            f"{ends.number} readings stick at the ends of the range {ends.text}: there they "
            "only bound the output, and are taken as missing"
        )
    y = np.where(ok, grid.y, 0.0)
    threshold = _threshold(grid, options)
    _refuse(grid, y, ok, threshold)
    orders = _orders(int(ok.sum()), options)
    if len(orders) < len(options.orders()):
        remarks.append(
            f"the log is long enough for order {orders[-1]} at most ({PER_NUMBER} readings a pole)"
        )
    silent = ok & (np.abs(y) <= threshold)
    zeros = silent.sum() > ZEROS * ok.sum()
    ahead = zeros if options.noise == "auto" else options.noise == "before"
    if options.noise == "before" and not silent.any():
        raise InputError(
            "noise: before the zone means exact zeros inside it, and no reading is silent; give"
            " --threshold, or --noise after"
        )
    start = grid.start
    if options.integrators:
        start = _stretches(grid)
        remarks.append(
            f"disturbances add up in an integrating plant: the log is taken as {start.size} records"
            " with a state of their own each"
        )
    data = _scaled(grid, start, y, ok, threshold, bool(ahead))
    stuck = ends.text if ends.found else ""
    if options.kind == "jump":
        data, limits, jumps = as_dead_zone(data, options)
        return Prepared(data, limits, orders, threshold, remarks, jumps, stuck)
    return Prepared(data, _limits(data, options), orders, threshold, remarks, ends=stuck)


def _spikes(y: Floats, ok: Flags) -> Integers:
    """Places of the few readings far beyond all others (one glitch would rule every sum)."""
    size = np.abs(y)
    usual = float(np.quantile(size[ok], 0.99))
    if usual == 0.0:
        return np.empty(0, int)
    beyond = np.flatnonzero(ok & (size > SPIKE * usual))
    return beyond if beyond.size <= max(1, RARE * ok.sum()) else np.empty(0, int)


def _require_silence_at_zero(grid: Grid) -> None:
    """Raise InputError where a reading that is not 0 comes back as a silence would."""
    y = grid.y[grid.ok]
    values, counts = np.unique(y, return_counts=True)
    if values.size < 3:
        return
    order = np.argsort(counts)
    most, next_most = int(order[-1]), int(order[-2])
    value, count = float(values[most]), int(counts[most])
    low, high = np.quantile(y[y != value], [0.05, 0.95]) if count < y.size else (value, value)
    inside = low < value < high
    if value != 0 and inside and count > ZEROS * y.size and count > OFTEN * counts[next_most]:
        raise InputError(
            f"log: the reading {value:.9g} comes back exactly in {100 * count / y.size:.0f} % of"
            f" the samples: is the sensor silent there, and not at 0? then say --zero {value:.9g}"
        )


def _threshold(grid: Grid, options: Options) -> float:
    """|y| up to which a reading is silent [y]."""
    if options.threshold is not None:
        return options.threshold
    return 0.5 * grid.quantum * (1 - 1e-9)


def _refuse(grid: Grid, y: Floats, ok: Flags, threshold: float) -> None:
    """Refuse a log that tells nothing. Raises InputError."""
    if y[ok].size < PER_NUMBER * 2:
        raise InputError(
            f"log: {int(ok.sum())} readings are too few; a plant of order 1 needs {2 * PER_NUMBER}"
        )
    moves = grid.u.std(axis=0) > 1e-12 * np.abs(grid.u).max(axis=0, initial=0.0)
    if not moves.any():
        raise InputError("log: the input is constant: nothing can be learnt about the plant")
    if not moves.all():
        name = grid.inputs[int(np.argmin(moves))]
        raise InputError(f"log: input {name!r} is constant; leave it out by --columns")
    if not np.any(np.abs(y[ok]) > threshold):
        raise InputError(
            "log: the sensor never speaks: every reading is silent, so nothing can be known;"
            " record with a larger input"
        )
    if np.ptp(y[ok]) <= 1e-12 * np.abs(y[ok]).max():
        raise InputError("log: the reading never changes: nothing can be known from it")


def _orders(count: int, options: Options) -> list[int]:
    """The orders that so many readings allow. Raises InputError."""
    orders = [n for n in options.orders() if count >= PER_NUMBER * (n + 1)]
    if not orders:
        least = options.orders()[0]
        raise InputError(
            f"log: {count} readings are too few for order {least}; it needs"
            f" {PER_NUMBER * (least + 1)}"
        )
    return orders


def _stretches(grid: Grid) -> Integers:
    """First samples of stretches of about STRETCH samples of each record."""
    ends = np.append(grid.start[1:], grid.t.size)
    starts = []
    for first, end in zip(grid.start, ends, strict=True):
        count = max(1, round((end - first) / STRETCH))
        starts.append(first + np.arange(count) * (end - first) // count)
    return np.concatenate(starts)


def _scaled(
    grid: Grid, start: Integers, y: Floats, ok: Flags, threshold: float, ahead: bool
) -> Data:
    """The records, scaled to rms 1."""
    u_scale = grid.u.std(axis=0)
    y_scale = float(np.sqrt(np.mean(y[ok] ** 2)))
    side = 1 * (y > threshold) - 1 * (y < -threshold)
    return Data(
        grid.u / u_scale,
        y / y_scale,
        ok,
        start,
        side,
        ahead,
        u_scale,
        y_scale,
    )


def _limits(data: Data, options: Options) -> Limits:
    """Limits of the widths, scaled; one that does not exist lies far away."""
    limits = []
    for name, sign in (("right", 1), ("left", -1)):
        low, high = options.bounds("right" if name == "right" else "left")
        if low == np.inf:
            if np.any(data.side[data.ok] == sign):
                raise InputError(
                    f"{name}: inf says that this edge does not exist, but readings lie beyond it"
                )
            low, high = FAR_EDGE * data.y_scale, FAR_EDGE * data.y_scale
        limits.append((low / data.y_scale, high / data.y_scale))
    tied = options.integrators > 0 and options.right is None and options.left is None
    return Limits(limits[0], limits[1], tied=tied)


FAR_EDGE = 100.0  # rms of y: an edge that is never reached
