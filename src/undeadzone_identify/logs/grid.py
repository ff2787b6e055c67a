"""Logs on a regular time grid: sample time, gaps as missing readings, quantum of readings."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.util.arrays import Flags, Floats, Integers
from undeadzone_identify.logs.log import Log
from undeadzone_identify.models.estimates import CachedMaxima

JITTER = 0.01  # of a step, by which regular times may differ
MOST_SWAY = 0.25  # of a step, by which they may differ at random, so that each has its own
SELDOM = 0.02  # share of intervals that may be no multiple of the step, and end a record
BRIDGED = 2.0  # steps between two readings, between which others are interpolated
LONG = 20  # steps; a longer gap begins a new record, since nobody knows the input in it
MOST = 100_000  # samples that are used; more would take minutes and say little more
MOST_SUMMED = 10_000  # of an integrating plant, whose log has a state every few hundred samples
STRETCHES = 5  # into which these are cut, of a longer log
RECORDS = 10  # that are used; the start of each costs a plant's order of parameters
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
        guessed: which column of the first log is which, as `--columns` has it; "" where known.
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
    guessed: str = ""
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
    pieces, steps = [], []
    remarks: list[str] = []
    known = min(log.r.shape[1] for log in logs)
    for log in logs:
        remarks += log.remarks
        if log.u.shape[1] != logs[0].u.shape[1]:
            raise InputError(
                f"{log.source}: has {log.u.shape[1]} inputs, others have another number"
            )
        found, is_regular = find_sample_time(log)
        apart = np.diff(log.t[np.isfinite(log.y).all(axis=1)])
        if not is_regular and apart.size and np.median(apart) > BRIDGED * found:
            found = float(np.median(apart))  # readings come more rarely than stamps
        steps.append(found if resample is None else resample)
        log = log._replace(r=log.r[:, :known])  # of one log alone, the reference is not used
        pieces.append(_put_on_grid(log, steps[-1], is_regular and resample is None, remarks))
    if max(steps) > min(steps) * (1 + JITTER):
        raise InputError(
            f"logs: steps differ, from {min(steps):.6g} to {max(steps):.6g} s. Use --resample STEP"
        )
    if known < max(log.r.shape[1] for log in logs):
        remarks.append("not every log has a reference: it is not used")
    t, u, y, begins = map(np.concatenate, zip(*pieces, strict=True))
    first, ok = logs[0], np.isfinite(y)
    u, r = np.split(u, [first.u.shape[1]], axis=1)
    y[ok] = round_to_steps(y[ok], remarks)
    return Grid(
        t,
        u,
        np.where(ok, y, 0.0),
        ok,
        np.flatnonzero(begins),
        float(np.mean(steps)),
        find_quantum(y[ok]),
        remarks,
        first.counted,
        first.inputs,
        first.input_unit,
        first.output_units[0],
        first.outputs[0],
        np.where(find_spikes(r, np.isfinite(r)), np.nan, r),
        first.guessed,
    )


def find_spikes(values: Floats, known: Flags) -> Flags:
    """Find the few values far beyond the rest, which would dominate every sum (N, or N x K).

    Args:
        values: a signal (N, or N x K).
        known: which of them there are.
    """
    size = np.abs(values)
    usual = np.quantile(size[known], 0.99) if known.any() else 0.0
    found = known & (size > SPIKE * usual)
    return found & (usual > 0) & (found.sum() <= max(1, RARE * known.sum()))


def shorten_log(grid: Grid, integrators: int = 0) -> Grid:
    """Select the longest records of many, and evenly spread stretches of a very long log.

    A remark says so; other logs stay.

    Args:
        grid: the records.
        integrators: of the plant.
    """
    lengths = np.diff(np.append(grid.start, grid.t.size))
    if lengths.size > RECORDS:
        longest = np.sort(np.argsort(-lengths, kind="stable")[:RECORDS])
        samples = np.concatenate([grid.start[k] + np.arange(lengths[k]) for k in longest])
        remark = (
            f"the {RECORDS} longest of {lengths.size} records are used, {samples.size} of"
            f" {grid.t.size} samples"
        )
        grid = _select_samples(grid, samples, np.isin(samples, grid.start), remark)
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
    begins = np.isin(samples, np.append(grid.start, firsts))
    return _select_samples(grid, samples, begins, remark)


def _select_samples(grid: Grid, samples: Integers, begins: Flags, remark: str) -> Grid:
    """Return a grid with some of its samples (N), flags of those that begin a record, a remark."""
    return grid._replace(
        **{name: getattr(grid, name)[samples] for name in ("t", "u", "r", "y", "ok")},
        start=np.flatnonzero(begins),
        remarks=[*grid.remarks, remark],
    )


class _Piece(NamedTuple):
    """Single log on its grid, missing readings NaN, the reference in columns behind u.

    Attributes:
        begins: whether a record begins with a sample (N).
    """

    t: Floats
    u: Floats
    y: Floats
    begins: Flags


def find_sample_time(log: Log) -> tuple[float, bool]:
    """Find the sample time of a log [s], and whether its times are regular.

    Args:
        log: its times increase.

    Returns:
        The median spacing, refined over the whole log, and whether nearly all times of a record
        are near its multiples; those of few digits may differ by their rounding.

    Raises:
        FileError: fewer than three samples.
    """
    if log.t.size < 3:
        raise FileError(f"{log.source}: {log.t.size} samples are too few")
    spacing = np.diff(log.t)
    step = float(np.median(spacing))
    spacing = spacing[spacing < (LONG + 0.5) * step]
    count = np.maximum(np.rint(spacing / step), 1.0)
    rounding = _print_error(log.t, step)
    near = np.abs(spacing - count * step) <= MOST_SWAY * step + rounding
    step = float(spacing[near].sum() / max(count[near].sum(), 1)) or step
    return step, bool(np.mean(near) >= 1 - SELDOM)


def _print_error(t: Floats, step: float) -> float:
    """Return the rounding error of printed times [s]; 0 if it hardly matters or is a step."""
    unit = last_decimal(t)
    return 1.01 * unit if unit < 0.25 * step else 0.0


def _put_on_grid(log: Log, step: float, is_regular: bool, remarks: list[str]) -> _Piece:
    """Return a log on multiples of a step: inputs held, readings between near ones at most.

    Args:
        log: with one output.
        step: of the grid [s].
        is_regular: whether each sample has a place of its own, and no reading lies between.
        remarks: list that is extended.
    """
    spacing = np.diff(log.t)
    usual = np.maximum(step, np.median(spacing))
    if is_regular:
        counts = np.maximum(np.rint(spacing / step), 1.0)
        odd = np.abs(spacing - counts * step) > MOST_SWAY * step + _print_error(log.t, step)
        odd &= spacing > BRIDGED * step  # below, a neighbour is early or late
        spacing = step * np.where(odd, 2.0 * LONG, counts)
    t = np.append(0.0, np.cumsum(spacing))
    first = np.flatnonzero(np.append(np.inf, spacing) > (LONG + 0.5) * usual)
    lengths = t[np.append(first[1:], t.size) - 1] - t[first]
    if not lengths.sum() / (20 * t.size) <= step < t[-1]:
        raise InputError(
            f"resample: a step of {step:g} s does not fit {t.size} samples in {t[-1]:g} s"
        )
    sizes = (lengths / step + 1 + (0.5 if is_regular else EXACT)).astype(int)
    start = np.cumsum(sizes) - sizes
    grid = np.repeat(t[first] - step * start, sizes) + step * np.arange(sizes.sum())
    known = np.isfinite(log.y[:, 0])
    times, y = t[known], log.y[known, 0]
    at = np.round(np.interp(grid, times, np.arange(times.size)), 6)
    beside = np.array([np.floor(at), np.ceil(at)], int)
    silent = (y[beside] == 0).any(axis=0)  # between 0 and a reading lies none
    new = np.interp(np.where(silent, np.rint(at), at), np.arange(y.size), y)
    apart = np.maximum(np.ptp(times[beside], axis=0), np.abs(grid - times[beside[0]]))
    if is_regular:
        near = apart < 0.5 * step
        notes = (
            (grid.size - t.size, "readings missing in gaps of {}; the input is held there"),
            (
                first.size - 1,
                f"gaps of {{}} are longer than {LONG} steps or no multiple of one; a new record"
                " begins after each",
            ),
        )
        remarks += [f"{count} {words.format(log.source)}" for count, words in notes if count]
    else:
        near = apart <= BRIDGED * usual * (1 + JITTER)
        quantum = find_quantum(y)
        new = np.rint(new / quantum) * quantum if quantum else new
        remarks.append(
            f"resampled to {step:.4g} s, which --resample changes: {near.sum()} readings from"
            f" {times.size}, none in gaps beyond {BRIDGED:g} steps, {first.size} records"
        )
    driving = np.hstack([log.u, log.r])[np.searchsorted(t, grid + 1e-6 * step, side="right") - 1]
    begins = np.isin(np.arange(grid.size), start)
    return _Piece(np.interp(grid, t, log.t), driving, np.where(near, new, np.nan), begins)


def find_quantum(y: Floats) -> float:
    """Find the spacing of readings that have few distinct values, like an encoder's [y].

    Args:
        y: readings (N), none missing.

    Returns:
        As of `rounding_step`; 0 if the readings are many and different.
    """
    different = np.unique(np.append(np.abs(y), 0.0))
    few = 4 <= different.size <= 0.5 * np.maximum(np.count_nonzero(y), 8)
    return common_spacing(different) if few else 0.0


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
    low, high = np.quantile(y, [RARELY, 1 - RARELY])
    waves = np.arange(FEWEST_LEVELS - 1, MOST_LEVELS, 0.2) / (high - low)
    some = y[:: 1 + y.size // SOME] - low
    means = np.exp(2j * np.pi * np.outer(waves, some)).mean(axis=1)
    best = np.argmax(np.abs(means))
    line = np.array([1.0, np.angle(means[best]) / (2 * np.pi)]) / waves[best]
    for _ in range(3):  # through the readings by their level
        line = np.polyfit(np.round((y - low - line[1]) / line[0]), y - low, 1)
    step = float(line[0])
    offset = math.remainder(line[1] + low, step)
    level = np.round((y - offset) / step)
    noise = np.std(y - offset - step * level)
    offset *= abs(offset) >= SURE * noise / math.sqrt(y.size)
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
    return rounding_step(values) or last_decimal(values)


def last_decimal(values: Floats) -> float:
    """Return the unit of the last decimal that values (N) have, of six at most; else 0."""
    off = 1e-9 * np.maximum(np.ptp(values), 1e-300) + np.spacing(np.abs(values).max())
    units = (10.0**-k for k in range(7) if np.abs(values - np.round(values, k)).max() < off)
    return next(units, 0.0)


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
    quantum = spacing.min()
    counts = np.round(moves / quantum)
    quantum = float(moves @ counts / (counts @ counts))
    odd = np.abs(moves / quantum - np.round(moves / quantum))
    return quantum if odd.max() < ODD and quantum > COARSER * moves[-1] else 0.0
