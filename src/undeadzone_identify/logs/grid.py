"""Logs on a regular time grid: sample time, gaps as missing readings, quantum of readings."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.samples import Regular, fill_gaps
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.logs.log import Log, sample_location
from undeadzone_identify.models.estimates import CachedMaxima
from undeadzone_identify.models.likelihood import root_mean_square

JITTER = 0.01  # of a step, by which regular times may differ
SWAYS, MOST_SWAY = 0.05, 0.25  # of a step: rms, and most, by which they may differ at random
SELDOM = 0.02  # share of intervals that may be no multiple of the step, and end a record
BRIDGED = 2.0  # steps between two readings, between which others are interpolated
LONG = 20  # steps; a longer gap begins a new record, since nobody knows the input in it
MOST = 100_000  # samples that are used; more would take minutes and say little more
MOST_SUMMED = 10_000  # of an integrating plant, whose log has a state every few hundred samples
STRETCHES = 5  # into which these are cut, of a longer log
EXACT = 1e-9  # of the range, by which two readings differ
COARSER = 1e-6  # of the range, from which a quantum matters
SPIKE = 10.0  # times the 99 % quantile of a size, beyond which few values are none
RARE = 0.005  # share of values that may be such
ODD = 0.1  # quanta by which a change may differ from a multiple
FEWEST_LEVELS, MOST_LEVELS = 4, 40  # about which the readings of a coarse sensor gather
RARELY = 0.01  # share of the readings about a level that is not counted
GATHERED = 0.25  # least mean cosine of phases about levels; noise of 0.25 steps leaves 0.29
HARDLY_BY_CHANCE = 12.0  # its square times the readings; of one step e^-12 are as large by chance
SURE = 4.0  # deviations
SOME = 2000  # readings that tell a step


class Grid(NamedTuple):
    """Records on a regular time grid, in sequence.

    Attributes:
        t: times (N) [s].
        u: inputs (N x m), held over gaps.
        y: readings (N), 0 if missing.
        ok: whether there is a reading (N).
        start: first sample of each record (R).
        step: sample time [s].
        quantum: smallest common spacing of the readings, 0 if there is none [y].
        remarks: on changes of the log, for the user.
        counted: whether times count samples.
        inputs: names of the inputs.
        input_unit, output_unit: units, "1" if unknown.
        output: name of the output.
        r: the reference (N x 1), NaN if it is missing or a spike; (N x 0) where a log has none.
        climbs: of fits of the log, those that were kept on disk; None: none are.
        zero: what the one input counts from [u]; None: from 0.
    """

    t: Floats
    u: Floats
    y: Floats
    ok: Flags
    start: Integers
    step: float
    quantum: float
    remarks: list[str]
    counted: bool
    inputs: tuple[str, ...]
    input_unit: str
    output_unit: str
    output: str
    r: Floats
    climbs: CachedMaxima | None = None
    zero: float | None = None


def to_grid(logs: list[Log], resample: float | None = None) -> Grid:
    """Convert logs of a single plant to a common regular grid.

    Args:
        logs: one or more; each begins a record with a state of its own.
        resample: step [s] to resample to; default: the step of the logs.

    Returns:
        The records, one after another.

    Raises:
        InputError: logs with different steps or numbers of inputs.
    """
    pieces = []
    steps = []
    remarks: list[str] = []
    for log in logs:
        remarks += log.remarks
        if log.u.shape[1] != logs[0].u.shape[1]:
            raise InputError(
                f"{log.source}: has {log.u.shape[1]} inputs, others have another number"
            )
        step, on_grid = resample, _resample_log
        if resample is None:
            step, is_regular = _regular_step(log)
            on_grid = _fill_regular if is_regular else _resample_log
        steps.append(step)
        pieces.append(on_grid(log, step, remarks))
    if max(steps) > min(steps) * (1 + JITTER):
        raise InputError(
            f"logs: steps differ, from {min(steps):.6g} to {max(steps):.6g} s. Use --resample STEP"
        )
    sizes = np.cumsum([0] + [piece.t.size for piece in pieces])
    starts = [piece.start + size for piece, size in zip(pieces, sizes[:-1], strict=True)]
    first = logs[0]
    m = first.u.shape[1]
    known = min(log.r.shape[1] for log in logs)  # of one log alone, the reference is not used
    if known < max(log.r.shape[1] for log in logs):
        remarks.append("not every log has a reference: it is not used")
    cut = [piece._replace(u=piece.u[:, : m + known]) for piece in pieces]
    t, u, y, _ = (np.concatenate(parts) for parts in zip(*cut, strict=True))
    u, r, ok = u[:, :m], u[:, m:], np.isfinite(y)
    y[ok] = round_to_steps(y[ok], remarks)
    return Grid(
        t,
        u,
        np.where(ok, y, 0.0),
        ok,
        np.concatenate(starts),
        float(np.mean(steps)),
        find_quantum(y[ok]),
        remarks,
        first.counted,
        first.inputs,
        first.input_unit,
        first.output_units[0],
        first.outputs[0],
        np.where(find_spikes(r, np.isfinite(r)), np.nan, r),
    )


def find_spikes(values: Floats, known: Flags) -> Flags:
    """Find the few values far beyond the rest, which would dominate every sum (N, or N x K).

    Args:
        values: a signal (N, or N x K).
        known: which of them there are.
    """
    size = np.abs(values)
    usual = float(np.quantile(size[known], 0.99)) if known.any() else 0.0
    found = known & (size > SPIKE * usual)
    return found & bool(usual > 0 and found.sum() <= max(1, RARE * known.sum()))


def shorten_log(grid: Grid, integrators: int = 0) -> Grid:
    """Select evenly spread stretches of a very long log, with a remark; short logs stay.

    Args:
        grid: the records.
        integrators: of the plant.
    """
    size = grid.t.size
    most = MOST_SUMMED if integrators else MOST
    if size <= most:
        return grid
    long = most // STRETCHES
    remark = (
        f"the log has {size} samples; {STRETCHES} stretches of {long}, evenly spread over it, are"
        " used: cut the log to use others"
    )
    firsts = np.linspace(0, size - long, STRETCHES).astype(int)
    samples = np.concatenate([np.arange(first, first + long) for first in firsts])
    begins = np.union1d(np.flatnonzero(np.isin(samples, grid.start)), long * np.arange(STRETCHES))
    return grid._replace(
        t=grid.t[samples],
        u=grid.u[samples],
        r=grid.r[samples],
        y=grid.y[samples],
        ok=grid.ok[samples],
        start=begins,
        remarks=[*grid.remarks, remark],
    )


class _Piece(NamedTuple):
    """Single log on its grid, missing readings NaN, the reference in columns behind u."""

    t: Floats
    u: Floats
    y: Floats
    start: Integers


def find_sample_time(log: Log) -> float:
    """Find the sample time of a log [s].

    Args:
        log: its times increase.

    Returns:
        The median spacing, refined over the whole log.

    Raises:
        FileError: fewer than two samples, or spacings that are no multiples of one step.
    """
    if log.t.size < 3:
        raise FileError(f"{log.source}: {log.t.size} samples are too few")
    spacing = np.diff(log.t)
    step = float(np.median(spacing))
    count = np.maximum(np.rint(spacing / step), 1.0)
    near = (np.abs(spacing - count * step) <= MOST_SWAY * step) & (count <= LONG)
    step = float(spacing[near].sum() / max(count[near].sum(), 1)) or step
    off = np.abs(spacing - count * step)
    if np.mean(near) >= 1 - SELDOM and root_mean_square(off[near]) <= SWAYS * step:
        return step
    allowed = JITTER * step * np.sqrt(count) + _print_error(log.t)
    bad = np.flatnonzero(off > allowed)
    if bad.size:
        worst = int(bad[np.argmax(off[bad])])
        raise FileError(
            f"{sample_location(log.source, log.lines, worst + 1)}: irregular step: "
            f"{spacing[worst]:.6g} s where the log has {step:.6g} s; "
            f"{bad.size} of {spacing.size} steps differ by more than 1 % from "
            f"a multiple. Use --resample {step:.3g}, or give times with more digits"
        )
    return step


def _regular_step(log: Log) -> tuple[float, bool]:
    """Return the step of a log, and whether it is regular; else the median. Raise FileError."""
    try:
        return find_sample_time(log), True
    except FileError:
        if log.t.size < 3:
            raise
        return float(np.median(np.diff(log.t))), False


def _print_error(t: Floats) -> float:
    """Return the rounding error of printed times [s]: their last decimal if these are few,
    else 0.
    """
    for digits in range(7):
        if np.abs(t - np.round(t, digits)).max() < 1e-9 * max(1.0, float(np.abs(t).max())):
            unit = 10.0**-digits
            step = float(np.median(np.diff(t)))
            return 1.01 * unit if unit < 0.25 * step else 0.0
    return 0.0


def _fill_regular(log: Log, step: float, remarks: list[str]) -> _Piece:
    """Return a log on multiples of a step; short gaps are filled, long gaps start a record."""
    spacing = np.diff(log.t, prepend=log.t[0] - step)
    steps = np.maximum(np.rint(spacing / step), 1.0)
    off = np.abs(spacing - steps * step)
    breaks = (steps > LONG) | (off > MOST_SWAY * step + _print_error(log.t))
    steps[breaks] = 1.0
    start = np.flatnonzero(breaks)
    place = np.cumsum(steps).astype(int) - 1
    whole = fill_gaps(Regular(log.t, log.y, np.hstack([log.u, log.r])), steps, step)
    last = np.maximum.accumulate(np.where(np.isfinite(whole.u[:, 0]), np.arange(whole.t.size), 0))
    missing = whole.t.size - log.t.size
    if missing:
        remarks.append(
            f"{missing} readings missing in gaps of {log.source}; the input is held there"
        )
    if start.size:
        remarks.append(
            f"{start.size} gaps of {log.source} are longer than {LONG} steps or no multiple of one;"
            " a new record begins after each"
        )
    return _Piece(whole.t, whole.u[last], whole.y[:, 0], np.append(0, place[start]))


def _resample_log(log: Log, step: float, remarks: list[str]) -> _Piece:
    """Return a log on a new grid: inputs held, readings between near ones, gaps not bridged."""
    length = log.t[-1] - log.t[0]
    if not 0 < step < length / 10:
        raise InputError(f"resample: a step of {step:g} s does not fit {length:g} s")
    spacing = np.diff(log.t)
    usual = max(step, float(np.median(spacing)))
    parts = np.split(log.t, np.flatnonzero(spacing > LONG * usual) + 1)
    sizes = [int((part[-1] - part[0]) / step + 1 + EXACT) for part in parts]
    if sum(sizes) > 20 * log.t.size:
        raise InputError(f"resample: a step of {step:g} s is far below the spacing of the log")
    t = np.concatenate(
        [part[0] + step * np.arange(n) for part, n in zip(parts, sizes, strict=True)]
    )
    known = np.isfinite(log.y[:, 0])
    times, y = log.t[known], log.y[known, 0]
    at = np.round(np.interp(t, times, np.arange(times.size)), 6)
    last, following = np.floor(at).astype(int), np.ceil(at).astype(int)
    silent = (y[last] == 0) | (y[following] == 0)  # between 0 and a reading lies none
    new = y[last] + np.where(silent, np.rint(at) - last, at - last) * (y[following] - y[last])
    apart = np.maximum(times[following] - times[last], np.abs(t - times[last]))
    near = apart <= BRIDGED * usual * (1 + JITTER)
    quantum = find_quantum(y)
    new = np.rint(new / quantum) * quantum if quantum else new
    remarks.append(
        f"resampled to {step:.4g} s, which --resample changes: {near.sum()} readings from"
        f" {times.size}, none in gaps beyond {BRIDGED:g} steps, {len(parts)} records"
    )
    driving = np.hstack([log.u, log.r])[np.searchsorted(log.t, t + 1e-6 * step, side="right") - 1]
    return _Piece(t, driving, np.where(near, new, np.nan), np.cumsum([0, *sizes[:-1]]))


def find_quantum(y: Floats) -> float:
    """Find the spacing of readings that have few distinct values, like an encoder's [y].

    Args:
        y: readings (N), none missing.

    Returns:
        As of `rounding_step`; 0 if the readings are many and different.
    """
    different = np.unique(np.append(np.abs(y), 0.0)).size
    few = 4 <= different <= 0.5 * max(int(np.count_nonzero(y)), 8)
    return rounding_step(y) if few else 0.0


def round_to_steps(y: Floats, remarks: list[str]) -> Floats:
    """Round readings to the steps that they gather about, if noise comes behind a coarse sensor.

    The mean of exp(2 pi i y / step) has an absolute value near 1 at the step, and near 0 if the
    readings lie anywhere. A plant that settles at levels passes between them, whereas a coarse
    sensor changes from one level to the next at once, so that readings beside changes count, too.

    Args:
        y: readings (N), none missing.
        remarks: list that is extended.

    Returns:
        The rounded readings; y itself without such steps.
    """
    if y.size < HARDLY_BY_CHANCE or np.mean(y[1:] == y[:-1]) > RARELY:  # noise does not repeat
        return y
    low, high = np.quantile(y, [RARELY, 1 - RARELY]).tolist()
    if not 0.0 < high - low < math.inf:
        return y
    scaled = (y - low) / (high - low)
    waves = np.arange(FEWEST_LEVELS - 1, MOST_LEVELS, 0.2)  # steps of the range
    some = scaled[:: -(-y.size // SOME)]
    means = np.exp(2j * np.pi * np.outer(waves, some)).mean(axis=1)
    best = int(np.argmax(np.abs(means)))
    line = np.array([1.0, np.angle(means[best]) / (2 * np.pi)]) / waves[best]
    for _ in range(3):  # through the readings by their level
        level = np.round((scaled - line[1]) / line[0])
        if np.ptp(level) < FEWEST_LEVELS - 1:
            return y
        line = np.polyfit(level, scaled, 1)
    step, offset = (high - low) * line + [0.0, low]
    offset -= step * round(offset / step)
    level = np.round((y - offset) / step)
    noise = float(np.std(y - offset - step * level))
    if abs(offset) < SURE * noise / math.sqrt(y.size):
        offset = 0.0
    rounded = offset + step * level
    gathered = np.cos(2 * np.pi * (y - rounded) / step)
    changes = np.flatnonzero(np.diff(level))
    for part in (np.union1d(changes, changes + 1), level != 0):  # a zone gathers readings at 0
        values = gathered[part]
        if values.mean() < max(GATHERED, math.sqrt(HARDLY_BY_CHANCE / values.size)):
            return y
    counts = np.unique(level, return_counts=True)[1]
    if np.sum(counts > RARELY * y.size) < FEWEST_LEVELS or noise < EXACT * step:
        return y
    remarks.append(
        f"the readings gather about steps of {step:.4g}, with noise of {noise:.2g}: they are taken"
        " as rounded to these steps"
    )
    return rounded


def rounding_step(y: Floats) -> float:
    """Return the common divisor of all readings (N) [y]; 0 if printing may have caused it."""
    return common_spacing(np.unique(np.append(np.abs(y), 0.0)))


def printed_step(values: Floats) -> float:
    """Return the common divisor of values (N), else the last decimal of all; 0 for neither.

    Args:
        values: none missing.
    """
    step = rounding_step(values)
    off = 1e-9 * max(float(np.ptp(values)), 1e-300)
    for digits in range(7):
        if step == 0 and np.abs(values - np.round(values, digits)).max() < off:
            step = 10.0**-digits
    return step


def common_spacing(values: Floats) -> float:
    """Return the common divisor of all differences of values; 0 without a common divisor.

    Args:
        values: in ascending order, all different (N).
    """
    moves = values - values[0]
    spacing = np.diff(values)
    spacing = spacing[spacing > EXACT * moves[-1]]
    if not spacing.size:
        return 0.0
    quantum = float(spacing.min())
    counts = np.round(moves / quantum)
    quantum = float(moves @ counts / (counts @ counts))
    odd = np.abs(moves / quantum - np.round(moves / quantum))
    return quantum if odd.max() < ODD and quantum > COARSER * moves[-1] else 0.0
