"""Logs from CSV, .npz, .mat, DataFrames and arrays, checked, and the options of a user.

Nothing in a file is ever executed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import Title, kind_of
from undeadzone.logs.names import Layout, layout_of_titles, numbers, parse_columns
from undeadzone.logs.samples import (
    MOST_UNREADABLE,
    REPEATED,
    LogReader,
    Samples,
    count_in_words,
    samples_of_text,
    without_repeats,
)
from undeadzone.logs.whole import BINARY, samples_of
from undeadzone.util.arrays import LARGEST, Floats
from undeadzone.util.files import LARGEST_TABLE

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
        try:
            rms = float(self.offset)
        except ValueError:
            rms = math.nan
        if not (math.isfinite(rms) and rms >= 0):
            raise InputError(f"offset: expected an rms >= 0 or free, found {self.offset!r}")
        return rms

    def parse_bounds(self, side: str) -> tuple[float, float]:
        """Return the least and the largest width of a side [y]: equal if the width is known.

        Args:
            side: "right" or "left".

        Raises:
            InputError: the option is not a width, two bounds or inf.
        """
        text = self.right if side == "right" else self.left
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
        for name in ("noise", "place", "kind"):
            words = get_args(get_type_hints(Options)[name])
            if getattr(self, name) not in words:
                found = getattr(self, name)
                raise InputError(f"{name}: expected {', '.join(words)}, found {found!r}")
        if self.integrators not in (0, 1, 2):
            raise InputError(f"integrators: expected 0, 1 or 2, found {self.integrators}")
        if self.place in ("actuator", "plant") and self.integrators:
            raise InputError(
                f"place: {self.place} is not asked of a plant with --integrators. Leave it out: a"
                " motor's friction is separated from a gap by itself"
            )
        if self.kind == "jump" and self.integrators:
            raise InputError("kind: a jump sensor's readings show z. It has no --integrators")
        is_known = self.delay == AT_ONCE or (self.delay.isdigit() and int(self.delay) <= MOST_LATE)
        if self.delay != "auto" and not is_known:
            raise InputError(
                f"delay: expected auto or {AT_ONCE} to {MOST_LATE} samples, found {self.delay!r}"
            )
        if not math.isfinite(self.zero):
            raise InputError(f"zero: expected a number, found {self.zero:g}")
        self.parse_orders()
        self.parse_offset_rms()
        self.parse_bounds("right")
        self.parse_bounds("left")
        if not 0.1 <= self.held_out <= 0.5:
            raise InputError(f"held_out: expected 0.1 to 0.5, found {self.held_out:g}")
        if self.threshold is not None and not 0 <= self.threshold < math.inf:
            raise InputError(f"threshold: must not be negative, found {self.threshold:g}")
        return self


def _parse_one_or_two(text: str, between: str, kind: Callable[[str], T]) -> list[T]:
    """Return a number or a pair of numbers; empty if the text has another form."""
    try:
        numbers = [kind(part) for part in text.split(between)]
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
        lines: the line of each sample in its file (N), for messages; empty if there is none.
        counted: whether the times count samples, so that no rate in seconds is known.
        r: the reference (N x 1), NaN if it is missing; (N x 0) where none was recorded.
        remarks: on omissions, for the user.
        has_clock: whether the times were recorded; else rows are counted, as those of a table.
    """

    t: Floats
    u: Floats
    y: Floats
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_unit: str
    output_units: tuple[str, ...]
    source: str
    lines: Any
    counted: bool
    r: Floats
    remarks: tuple[str, ...] = ()
    has_clock: bool = True

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
        return self._replace(
            y=self.y[:, k : k + 1],
            outputs=self.outputs[k : k + 1],
            output_units=self.output_units[k : k + 1],
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
    samples, repeated = without_repeats(samples)
    mended: list[str] = []
    if layout.time is None:
        samples = samples._replace(t=np.arange(samples.t.size, dtype=float))
    if not strict:
        samples = _mend_times(_hold_inputs(samples, mended), mended)
    t = samples.t
    lines = samples.lines
    outputs = tuple(title.name for title in layout.reading_titles)
    inputs = tuple(title.name for title in layout.input_titles)
    y = np.where(np.isfinite(samples.y), samples.y, np.nan)
    _require_increasing(t, source, lines)
    u, r = np.split(samples.u, [len(inputs)], axis=1)
    _require_finite_inputs(u, inputs, source, lines)
    for name, column in zip(outputs, y.T, strict=True):
        if np.isnan(column).all():
            raise FileError(f"{source}: {name} holds no reading: every one is missing")
        if np.nanmax(np.abs(column)) > LARGEST:
            raise FileError(f"{source}: {name} holds numbers beyond {LARGEST:g}")
    driving = layout.input_titles[: 1 if layout.has_current else None]
    units = {title.unit or "1" for title in driving}
    remarks = [f"{source}: {remark}" for remark in mended]
    if layout.reference is not None or not layout.is_certain:
        rest = f", not {layout.unused}" if layout.unused else ""
        remarks.insert(0, f'{source}: read as --columns "{layout.columns_text}"{rest}')
    if repeated:
        remarks.append(
            f"{source}: {repeated} samples have the time of the one before, and are left out"
        )
    if r.size and np.isnan(r).all():
        raise FileError(f"{source}: the reference holds no number: every one is missing")
    return Log(
        t,
        u,
        y,
        inputs,
        outputs,
        units.pop() if len(units) == 1 else "1",
        tuple(title.unit or "1" for title in layout.reading_titles),
        source,
        lines,
        layout.seconds is None or layout.time is None,
        np.where(np.isfinite(r), r, np.nan),
        tuple(remarks),
        layout.time is not None,
    )


def _hold_inputs(samples: Samples, remarks: list[str]) -> Samples:
    """Return samples whose missing inputs are those before, from the first known ones on."""
    known = np.isfinite(samples.u)
    missing = int((~known).any(axis=1).sum())
    if not missing:
        return samples
    remarks.append(f"{missing} inputs are missing, and count as held")
    last = np.maximum.accumulate(known * np.arange(len(known))[:, None], axis=0)
    u = np.take_along_axis(samples.u, last, axis=0)
    begun = (np.isfinite(u) | ~known.any(axis=0)).all(axis=1)
    return samples._replace(u=u).select_rows(begun)


def _mend_times(samples: Samples, remarks: list[str]) -> Samples:
    """Return samples without single wrong times, sessions one after another, equal times spread.

    Too many wrong times stay as they are, and are refused.
    """
    rows = np.flatnonzero(np.isfinite(samples.t))
    t = samples.t[rows]
    back = np.flatnonzero(np.diff(t) < 0)
    is_late = np.append(t, np.inf)[back + 2] > t[back]
    is_early = t[back + 1] > np.append(-np.inf, t)[back]
    wrong = np.where(is_late, back + 1, back)[is_late | is_early]
    rows = np.delete(rows, wrong)
    between = np.diff(samples.t[rows])
    left_out, begun = samples.t.size - rows.size, int((between < 0).sum())
    if max(left_out, 10 * begun) > REPEATED * samples.t.size or not (between > 0).any():
        return samples
    usual = float(np.median(between[between > 0]))
    between[between < 0] = SESSIONS * usual
    for count, what in (
        (left_out, "samples have a missing or wrong time, and are left out"),
        (begun, "times the time begins anew: each session is a record"),
        ((between == 0).sum(), "times repeat the one before, and are spread evenly"),
    ):
        remarks += [f"{count} {what}"] * bool(count)
    t = samples.t[rows[0]] + np.append(0.0, np.cumsum(between))
    first = np.flatnonzero(np.append(1.0, between))
    count = np.diff(np.append(first, t.size))
    width = np.minimum(np.diff(t[first], append=np.inf), usual) / count
    place = np.arange(t.size) - np.repeat(first, count)
    return samples.select_rows(rows)._replace(t=t + place * np.repeat(width, count))


def sample_location(source: str, lines: Any, index: int) -> str:
    """Return the place of a sample for messages: its line if the file has lines."""
    if len(lines):
        return f"{source}, line {int(lines[index])}"
    return f"{source}, sample {index}"


def _require_increasing(t: Floats, source: str, lines: Any) -> None:
    """Require that every time is finite and later than the previous time. Raise FileError."""
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise FileError(
            f"{sample_location(source, lines, bad[0])}: the time is missing or not finite"
        )
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        index = int(back[0]) + 1
        raise FileError(
            f"{sample_location(source, lines, index)}: time does not increase: "
            f"{t[index]:.9g} s after {t[index - 1]:.9g} s. Sort the "
            "lines, or give logs of several runs as several files"
        )


def _require_finite_inputs(u: Floats, inputs: Sequence[str], source: str, lines: Any) -> None:
    """Require that every input is finite and of sensible size. Raise FileError."""
    bad = np.argwhere(~np.isfinite(u) | (np.abs(u) > LARGEST))
    if bad.size:
        row, column = bad[0]
        raise FileError(
            f"{sample_location(source, lines, int(row))}: input {inputs[column]!r} is "
            "missing or not a usable number. An input must be known at every sample"
        )


# --- Where it comes from


def read_log(source: Any, columns: str | None = None, strict: bool = False) -> Log:
    """Read the log in a file or DataFrame.

    Args:
        source: path of a CSV, .npz, .mat or .jsonl file, or a pandas DataFrame with the columns.
        columns: which column is which where names do not say it: `t=1,y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error; else its sample is missing.

    Returns:
        The log, its times in seconds.

    Raises:
        FileError: the fault, with file and line if there are any.
    """
    chosen = parse_columns(columns)
    remarks: list[str] = []
    if hasattr(source, "columns") and hasattr(source, "index"):
        name = "DataFrame"
        samples, layout = samples_of(source, None, None, chosen, name)
    elif not isinstance(source, str | os.PathLike):
        raise InputError(f"log: expected a path or a DataFrame, found {type(source).__name__}")
    else:
        path = Path(source)
        name = str(source)
        if path.suffix.lower() in BINARY:
            samples, layout = samples_of(path, None, None, chosen, name)
        else:
            samples, layout = _read_csv_samples(path, chosen, strict, remarks)
    log = log_from_samples(samples, layout, name, strict)
    return log._replace(remarks=(*log.remarks, *remarks))


def _read_csv_samples(
    path: Path, chosen: Mapping[str, str], strict: bool, remarks: list[str]
) -> tuple[Samples, Layout]:
    """Read the samples of a CSV file, without unreadable lines. Raise FileError."""
    reader = LogReader(str(path), None, None, chosen, strict)
    samples = samples_of_text(reader, path, LARGEST_TABLE, math.inf)
    if reader.layout is None or not samples.t.size:
        raise FileError(f"{path}: holds no samples")
    if reader.ahead:
        remarks.append(f"{path}: {count_in_words(reader.ahead)} ahead of the header skipped")
    if reader.faults.unreadable:
        samples = _drop_unreadable(samples, reader, path)
        remarks.append(
            f"{path}: {count_in_words(reader.faults.unreadable)} cannot be read and count as "
            f"missing; {reader.faults.why}"
        )
    return samples, reader.layout


def _drop_unreadable(samples: Samples, reader: LogReader, path: Path) -> Samples:
    """Return the samples with any readable value. Raise FileError if these are few."""
    if reader.faults.unreadable > MOST_UNREADABLE * samples.t.size:
        raise FileError(
            f"{path}: {count_in_words(reader.faults.unreadable)} of {samples.t.size} cannot be "
            f"read; {reader.faults.why}"
        )
    some = np.isfinite(np.column_stack([samples.t, samples.y, samples.u])).any(axis=1)
    return Samples(*[part[some] for part in samples])


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
    readings = _to_rows("y", numbers("y", y, "iuf"))
    inputs = _to_rows("u", numbers("u", u, "iuf"))
    times = numbers("t", t, "iuf")
    if times.ndim == 0:
        times = float(times) * np.arange(len(readings))
    times = times.ravel()
    reference = np.empty((len(inputs), 0)) if r is None else _to_rows("r", numbers("r", r, "iuf"))
    row_counts = [times.size, len(inputs), len(readings), len(reference)]
    if len(set(row_counts)) > 1 or reference.shape[1] > 1:
        shapes = f"{times.shape}, {inputs.shape}, {readings.shape}, {reference.shape}"
        raise InputError(f"t, u, y, r: expected as many rows in each, one r, found {shapes}")
    layout = _array_layout(readings.shape[1], inputs.shape[1])
    samples = Samples(times, readings, np.hstack([inputs, reference]), np.empty(0, np.int64))
    return log_from_samples(samples, layout, "arrays")


def _array_layout(p: int, m: int) -> Layout:
    """Return the column layout of arrays."""
    titles = [Title("t", "s")]
    for signal, count in (("y", p), ("u", m)):
        names = [signal] if count == 1 else [f"{signal}[{i}]" for i in range(count)]
        titles += [Title(name, "") for name in names]
    return layout_of_titles(titles, p, m, {}, "arrays")


def _to_rows(key: str, array: Any) -> Any:
    """Return an array with a row for each sample. Raise InputError."""
    if array.ndim == 1:
        return array[:, None]
    if array.ndim == 2 and 1 in array.shape and array.shape[1] != 1:
        return array.T
    if array.ndim != 2:
        raise InputError(f"{key}: expected a row for each sample, found shape {array.shape}")
    return array
