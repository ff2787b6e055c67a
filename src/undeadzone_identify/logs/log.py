"""Logs from CSV, .npz, .mat, DataFrames and arrays, checked, and the options of a user.

Nothing in a file is ever executed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import kind_of
from undeadzone.logs.names import Layout, parse_columns
from undeadzone.logs.samples import (
    MOST_UNREADABLE,
    REPEATED,
    Faults,
    Samples,
    count_in_words,
    require_increasing,
    without_repeats,
)
from undeadzone.logs.whole import NOT_CSV, WholeLog, read_whole, samples_of, samples_of_arrays
from undeadzone.util.arrays import Floats, hold_last
from undeadzone.util.files import LARGEST_TABLE
from undeadzone_identify.logs.tables import Arrays, read_named_values, read_parquet

T = TypeVar("T", int, float)

MOST_POLES = 8
MOST_LATE = 1000  # samples
SESSIONS = 1000.0  # usual steps that are put between two sessions of one file
AT_ONCE = "-1"  # delay of a recording whose readings answer to the input of their own row


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of an identification beside the log.

    Attributes:
        order: orders of the plant to try, as "2" or "1-4"; default 1-4.
        right, left: widths as in "0.5" (known), "0.2,1.0" (bounds) or "inf" (no edge on that
            side) [y]; default: from the log.
        offset: rms of a constant offset of the output [y], or "free": then the width alone has an
            interval; default 0, none.
        held_out: share of the log, in blocks over it, that checks the fit; default 0.3.
        noise: before (ahead of the zone), after, or auto: from exact zeros in the log.
        place: where the zone is: sensor if the user knows, auto to find out.
        kind: deadzone, jump (readings are not shifted), play or backlash, or auto: the log
            decides.
        delay: samples by which the input acts late: auto, or a number that belongs to the
            recording.
        zero: reading of the sensor inside its zone [y]; it is taken off every reading.
        threshold: |y| up to which a reading counts as silent [y]; default: half the quantum.
        integrators: how many poles of the plant are integrators, as one of a motor's position.
        resample: step [s] onto which an irregular log is put; default: none.
    """

    order: str = "1-4"
    right: str | None = None
    left: str | None = None
    offset: str = "0"
    held_out: float = 0.3
    noise: Literal["before", "after", "auto"] = "auto"
    place: Literal["sensor", "actuator", "plant", "auto"] = "auto"
    kind: Literal["deadzone", "jump", "play", "backlash", "auto"] = "auto"
    delay: str = "auto"
    zero: float = 0.0
    threshold: float | None = None
    resample: float | None = None
    integrators: int = 0

    def __post_init__(self) -> None:
        """Store the kind "backlash" under its one internal name, "play"."""
        if self.kind == "backlash":
            msgspec.structs.force_setattr(self, "kind", "play")

    @property
    def recorded_delay(self) -> int:
        """Return the delay of the inputs in the recording in samples, 0 if not given."""
        return 0 if self.delay == "auto" else int(self.delay)

    def parse_orders(self) -> range:
        """Return the orders to try. Raise InputError."""
        ends = _parse_one_or_two(self.order, "-", int)
        if not ends or not 1 <= ends[0] <= ends[-1] <= MOST_POLES:
            raise InputError(
                f"order: expected a number or a range within 1 to {MOST_POLES}, as 2 or 1-4,"
                f" found {self.order!r}"
            )
        return range(max(ends[0], self.integrators), max(ends[-1], self.integrators) + 1)

    def parse_offset_rms(self) -> float | None:
        """Return the rms of an unknown output offset [y]; None if it is free.

        Raises InputError.
        """
        if self.offset == "free":
            return None
        rms = (_parse_one_or_two(self.offset, ",", float) or [math.nan])[0]
        if not 0 <= rms < math.inf:
            raise InputError(f"offset: expected an rms >= 0 or free, found {self.offset!r}")
        return rms

    def parse_bounds(self, side: str) -> tuple[float, float]:
        """Return the least and the largest width of a side [y]: equal if the width is known.

        Args:
            side: "right" or "left".

        Raises:
            InputError: the option is not a width, two bounds or inf.
        """
        text = getattr(self, side)
        if text is None:
            return (-math.inf, math.inf)
        bounds = _parse_one_or_two(text, ",", float)
        if not bounds or not 0 <= bounds[0] <= bounds[-1]:
            raise InputError(
                f"{side}: expected a width, two bounds or inf, as 0.5, 0.2,1.0 or inf,"
                f" found {text!r}"
            )
        return (bounds[0], bounds[-1])

    def require_usable(self) -> Options:
        """Return these options if every value is usable. Raise InputError."""
        hints = get_type_hints(Options)
        words = {name: get_args(hints[name]) for name in ("noise", "place", "kind")}
        for name, is_usable, expected in (
            *(
                (name, getattr(self, name) in known, ", ".join(known))
                for name, known in words.items()
            ),
            ("integrators", self.integrators in (0, 1, 2), "0, 1 or 2"),
            (
                "delay",
                self.delay in ("auto", AT_ONCE)
                or (self.delay.isdigit() and int(self.delay) <= MOST_LATE),
                f"auto or {AT_ONCE} to {MOST_LATE} samples",
            ),
            ("zero", math.isfinite(self.zero), "a number"),
            ("held_out", 0.1 <= self.held_out <= 0.5, "0.1 to 0.5"),
            ("threshold", 0 <= (self.threshold or 0.0) < math.inf, "a number >= 0"),
        ):
            if not is_usable:
                raise InputError(f"{name}: expected {expected}, found {getattr(self, name)!r}")
        if self.place in ("actuator", "plant") and self.integrators:
            raise InputError(
                f"place: {self.place} is not supported for a plant with --integrators. Leave it "
                f"out: a"
                " motor's friction is separated from a gap by itself"
            )
        if self.kind == "jump" and self.integrators:
            raise InputError("kind: a jump sensor's readings show z. It has no --integrators")
        self.parse_orders()
        self.parse_offset_rms()
        self.parse_bounds("right")
        self.parse_bounds("left")
        return self


def _parse_one_or_two(text: str, between: str, kind: Callable[[str], T]) -> list[T]:
    """Return a number or a pair of numbers; empty if the text has another form."""
    try:
        numbers = list(map(kind, text.split(between)))
    except ValueError:
        return []
    return numbers if len(numbers) in (1, 2) else []


# --- A log


class Log(NamedTuple):
    """Log of a plant.

    Attributes:
        t: times (N) [s], increasing.
        u: inputs (N x m).
        y: readings (N x p); NaN if one is missing.
        inputs, outputs: names of the inputs (m) and of the readings (p)
        input_unit: unit of the inputs, "1" where none is named, or several differ.
        output_units: units of the readings (p), "1" where none is named.
        source: where the log came from, for messages.
        counted: whether the times count samples, so that no rate in seconds is known.
        r: the reference (N x 1), NaN if it is missing; (N x 0) where none was recorded.
        remarks: on omissions, for the user.
        has_clock: whether the times were recorded; else rows are counted, as those of a table.
        guessed: which column is which, as `--columns` has it; "" where names or the user decided.
    """

    t: Floats
    u: Floats
    y: Floats
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_unit: str
    output_units: tuple[str, ...]
    source: str
    counted: bool
    r: Floats
    remarks: tuple[str, ...] = ()
    has_clock: bool = True
    guessed: str = ""

    @property
    def input_kinds(self) -> tuple[str, ...]:
        """Return what the inputs hold, by their names and unit, as `kind_of` has it (m)."""
        return tuple(kind_of(name, self.input_unit) for name in self.inputs)

    @property
    def output_kinds(self) -> tuple[str, ...]:
        """Return what the readings hold, by their names and units, as `kind_of` has it (p)."""
        return tuple(map(kind_of, self.outputs, self.output_units))

    def select_output(self, k: int) -> Log:
        """Return the log with a single output."""
        one = slice(k, k + 1)
        return self._replace(
            y=self.y[:, one], outputs=self.outputs[one], output_units=self.output_units[one]
        )


def log_from_samples(samples: Samples, layout: Layout, source: str, strict: bool = True) -> Log:
    """Build a log from samples, valid for identification.

    Args:
        samples: times, readings, inputs with the reference behind them.
        layout: where they came from, with units.
        source: the log, for messages.
        strict: whether a wrong time or a missing input is an error; else the sample is left out,
            the input held, and a session whose time begins again is a record.

    Returns:
        The log; times that count samples have 1 s between two of them.

    Raises:
        FileError: times that do not increase, a missing input, readings that are all missing.
    """
    if layout.time is None:
        samples = samples._replace(t=np.arange(samples.t.size, dtype=float))
    samples, repeated = without_repeats(samples)
    mended = [(repeated, "samples have the time of the one before, and are left out")]
    if not strict:
        samples = _mend_times(_hold_inputs(samples, mended), mended)
    require_increasing(samples, source)
    outputs = tuple(title.name for title in layout.reading_titles)
    inputs = tuple(title.name for title in layout.input_titles)
    u, r = np.split(samples.u, [len(inputs)], axis=1)
    for row, column in np.argwhere(np.isnan(u))[:1]:
        raise FileError(
            f"{source}, line {samples.lines[row]}: input {inputs[column]!r} is missing or not a"
            " usable number. An input must be known at every sample"
        )
    for name, column in zip((*outputs, "the reference"), np.hstack([samples.y, r]).T, strict=False):
        if np.isnan(column).all():
            raise FileError(f"{source}: {name} holds no number: every one is missing")
    driving = layout.input_titles[: 1 if layout.has_current else None]
    units = {title.unit or "1" for title in driving}
    remarks = [f"{source}: {count} {what}" for count, what in mended if count]
    if layout.reference is not None or not layout.is_certain:
        rest = f"; next best: {layout.next_text}" if layout.next_text else ""
        rest += f", not {layout.unused}" if layout.unused else ""
        remarks.insert(0, f'{source}: read as --columns "{layout.columns_text}"{rest}')
    return Log(
        samples.t,
        u,
        samples.y,
        inputs,
        outputs,
        units.pop() if len(units) == 1 else "1",
        tuple(title.unit or "1" for title in layout.reading_titles),
        source,
        not layout.has_times,
        r,
        tuple(remarks),
        layout.time is not None,
        "" if layout.is_certain else layout.columns_text,
    )


def _hold_inputs(samples: Samples, mended: list[tuple[int, str]]) -> Samples:
    """Return samples whose missing inputs are those before, from the first known ones on.

    Args:
        samples: of the log.
        mended: counts of changes, with words, to which others are added.
    """
    known = np.isfinite(samples.u)
    missing = (~known).any(axis=1).sum()
    mended.append((missing, "inputs are missing, and count as held"))
    u = hold_last(samples.u)
    begun = (np.isfinite(u) | ~known.any(axis=0)).all(axis=1)
    return samples._replace(u=u).select_rows(begun)


def _mend_times(samples: Samples, mended: list[tuple[int, str]]) -> Samples:
    """Return samples without single wrong times, sessions one after another, equal times spread.

    Too many wrong times stay as they are, and are refused.

    Args:
        samples: of the log.
        mended: counts of changes, with words, to which others are added.
    """
    rows = np.flatnonzero(np.isfinite(samples.t))
    t = samples.t[rows]
    before, after = np.append(-np.inf, t[:-1]), np.append(t[1:], np.inf)
    wrong = (before < after) & ((t < before) | (t > after))
    wrong[:-1] &= ~wrong[1:] | (t[:-1] <= t[1:])  # of two about a fall, the later one
    rows = rows[~wrong]
    between = np.diff(samples.t[rows])
    left_out, begun = samples.t.size - rows.size, (between < 0).sum()
    if max(left_out, begun) > REPEATED * samples.t.size or not (between > 0).any():
        return samples
    usual = np.median(between[between > 0])
    between[between < 0] = SESSIONS * usual
    mended += [
        (left_out, "samples have a missing or wrong time, and are left out"),
        (begun, "times the time begins anew: each session is a record"),
        ((between == 0).sum(), "times repeat the one before, and are spread evenly"),
    ]
    t = samples.t[rows[0]] + np.append(0.0, np.cumsum(between))
    first = np.flatnonzero(np.append(1.0, between))
    count = np.diff(first, append=t.size)
    width = np.minimum(np.diff(t[first], append=np.inf), usual) / count
    place = np.arange(t.size) - np.repeat(first, count)
    return samples.select_rows(rows)._replace(t=t + place * np.repeat(width, count))


# --- Where it comes from


def read_log(source: Any, columns: str | None = None, strict: bool = False) -> Log:
    """Read the log in a file or DataFrame.

    Args:
        source: path of a CSV, .npz, .mat, .json or .jsonl file, or a pandas DataFrame with the
            columns.
        columns: which column is which where names do not say it: `t=1,y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error; else its sample is missing.

    Returns:
        The log, its times in seconds.

    Raises:
        FileError: the fault, with file and line if there are any.
    """
    read = _read_whole(source, parse_columns(columns), strict)
    samples, name, faults, remarks = read.samples, read.source, read.faults, list[str]()
    if read.layout is None or not samples.t.size:
        raise FileError(f"{name}: holds no samples")
    if read.ahead:
        remarks.append(f"{name}: {count_in_words(read.ahead)} ahead of the header skipped")
    if faults.unreadable:
        lines = f"{name}: {count_in_words(faults.unreadable)}"
        remarks.append(f"{lines} cannot be read and count as missing; {faults.why}")
        some = np.isfinite(np.column_stack([samples.t, samples.y, samples.u])).any(axis=1)
        samples = samples.select_rows(some)
    log = log_from_samples(samples, read.layout, name, strict)
    return log._replace(remarks=(*log.remarks, *remarks))


def _read_whole(source: Any, chosen: dict[str, str], strict: bool) -> WholeLog:
    """Read all samples: of a table of signals, else of one with a line for each value.

    Raises FileError.
    """
    path = Path(source) if isinstance(source, str | os.PathLike) else None
    if path and path.suffix.lower() == ".parquet":
        return _whole_of_arrays(path, read_parquet(path), chosen)
    try:
        read = read_whole(source, None, None, chosen, strict, LARGEST_TABLE)
        bad, count = read.faults.unreadable, read.samples.t.size
        if bad > MOST_UNREADABLE * count:
            lines = f"{read.source}: {count_in_words(bad)} of {count} cannot be read"
            raise FileError(f"{lines}; {read.faults.why}")
    except FileError:
        if path is None or path.suffix.lower() in NOT_CSV:
            raise
        arrays = read_named_values(path)
        if arrays is None:
            raise
        read = _whole_of_arrays(path, arrays, chosen)
    return read


def _whole_of_arrays(path: Path, arrays: Arrays, chosen: dict[str, str]) -> WholeLog:
    """Return the samples of arrays from a file."""
    name = str(path)
    return WholeLog(name, *samples_of(arrays, None, None, chosen, name), Faults(name, False))


def log_from_arrays(t: Any, u: Any, y: Any, r: Any = None) -> Log:
    """Build a log from arrays.

    Args:
        t: times (N) [s], or one number, the sample time [s].
        u: inputs (N) or (N x m).
        y: readings (N) or (N x p); NaN if one is missing.
        r: the reference (N), NaN if it is missing; None: it was not recorded.

    Returns:
        The log.

    Raises:
        InputError: arrays of different lengths, or not numeric.
    """
    samples, layout = samples_of_arrays({"t": t, "u": u, "y": y, "r": r})
    return log_from_samples(samples, layout._replace(reference=None), "arrays")
