"""A log as it was recorded: times, inputs and readings, checked for usual mistakes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.errors import FileError
from undeadzone.support.arrays import LARGEST, Floats

Flags = npt.NDArray[np.bool_]

SECONDS = {
    "": 1.0,
    "s": 1.0,
    "sec": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
    "samples": 1.0,
    "sample": 1.0,
}  # length of a unit of time [s]; a time that counts samples is taken to have 1 s between them


class Log(NamedTuple):
    """A record of one plant.

    Attributes:
        t: times (N) [s], increasing.
        u: inputs (N x m).
        y: readings (N); NaN where one is missing.
        inputs: names of the inputs (m).
        output: name of the reading.
        input_unit, output_unit: their units, "1" where none is named.
        source: where the log came from, for messages.
        lines: the line of each sample in its file (N), for messages; empty where there is none.
        counted: whether the times count samples, so that no rate in seconds is known.
    """

    t: Floats
    u: Floats
    y: Floats
    inputs: tuple[str, ...]
    output: str
    input_unit: str
    output_unit: str
    source: str
    lines: Any
    counted: bool


class Column(NamedTuple):
    """A column of a table: its name without the unit, its unit ("" if none), its numbers (N)."""

    name: str
    unit: str
    values: Floats


def split_unit(title: str) -> tuple[str, str]:
    """Name and unit of a header: `speed [rad/s]` or `speed (rad/s)`; an index `u[0]` is no unit."""
    text = title.strip().strip("\"'").strip()
    for opening, closing in (("[", "]"), ("(", ")")):
        start = text.rfind(opening)
        if start <= 0 or not text.endswith(closing):
            continue
        inside = text[start + 1 : -1].strip()
        if not inside.isdigit():
            return text[:start].strip(), inside
    return text, ""


def make_log(
    time: Column, inputs: list[Column], output: Column, source: str, lines: Any = ()
) -> Log:
    """A checked log from its columns.

    Args:
        time: times; the unit says whether they are in seconds.
        inputs: one column per input, at least one.
        output: the readings; NaN where one is missing.
        source: where they came from, for messages.
        lines: line of each sample in the file (N), if there is one.

    Returns:
        The log, its times in seconds.

    Raises:
        FileError: a unit of time that is not understood, times that do not increase, a missing
            input, readings that are all missing.
    """
    unit = time.unit.lower()
    if unit not in SECONDS:
        raise FileError(
            f"{source}: unit of time not understood: {time.unit!r}; use s, ms, us, min, h,"
            " or samples"
        )
    t = time.values * SECONDS[unit]
    u = np.column_stack([column.values for column in inputs])
    y = np.where(np.isfinite(output.values), output.values, np.nan)
    _check_times(t, source, lines)
    _check_inputs(u, inputs, source, lines)
    if np.isnan(y).all():
        raise FileError(f"{source}: column {output.name!r} holds no reading: every one is missing")
    if np.nanmax(np.abs(y)) > LARGEST:
        raise FileError(f"{source}: column {output.name!r} holds numbers beyond {LARGEST:g}")
    names = tuple(column.name for column in inputs)
    units = {column.unit or "1" for column in inputs}
    input_unit = units.pop() if len(units) == 1 else "1"
    return Log(
        t,
        u,
        y,
        names,
        output.name,
        input_unit,
        output.unit or "1",
        source,
        lines,
        unit.startswith("sample"),
    )


def where(source: str, lines: Any, index: int) -> str:
    """The place of a sample, for messages: its line where the file has one."""
    if len(lines):
        return f"{source}, line {int(lines[index])}"
    return f"{source}, sample {index}"


def _check_times(t: Floats, source: str, lines: Any) -> None:
    """Every time is a number and later than the one before. Raises FileError."""
    bad = np.flatnonzero(~np.isfinite(t))
    if bad.size:
        raise FileError(f"{where(source, lines, bad[0])}: the time is missing or not finite")
    back = np.flatnonzero(np.diff(t) <= 0)
    if back.size:
        index = int(back[0]) + 1
        raise FileError(
            f"{where(source, lines, index)}: time does not increase: {t[index]:.9g} s after"
            f" {t[index - 1]:.9g} s; sort the lines, or give logs of several runs as several files"
        )


def _check_inputs(u: Floats, inputs: list[Column], source: str, lines: Any) -> None:
    """Every input is a number of sensible size. Raises FileError."""
    bad = np.argwhere(~np.isfinite(u) | (np.abs(u) > LARGEST))
    if bad.size:
        row, column = bad[0]
        raise FileError(
            f"{where(source, lines, int(row))}: input {inputs[column].name!r} is missing or not a"
            " usable number; an input must be known at every sample"
        )
