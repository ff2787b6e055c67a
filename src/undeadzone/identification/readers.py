"""Logs from CSV, .npz, .mat, DataFrames and arrays; nothing in a file is ever executed."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.identification.log import Log, checked_log
from undeadzone.logs.names import Layout, Title, layout_of_titles, numbers, parse_columns
from undeadzone.logs.samples import MOST_UNREADABLE, LogReader, Samples, counted_lines
from undeadzone.logs.text import blocks_of
from undeadzone.logs.whole import BINARY, samples_of
from undeadzone.support.files import LARGEST_TABLE


def read_log(source: Any, columns: str | None = None, strict: bool = False) -> Log:
    """The log in a file or DataFrame.

    Args:
        source: path of a CSV, .npz or .mat file, or a pandas DataFrame with the columns.
        columns: which column is which where names do not say it: `t=1,y=angle,u=voltage`.
        strict: whether a line that cannot be read is an error; else its sample is missing.

    Returns:
        The log, its times in seconds.

    Raises:
        FileError: what is wrong, with file and line where there are any.
    """
    chosen = parse_columns(columns)
    remarks: list[str] = []
    if hasattr(source, "columns") and hasattr(source, "index"):
        name = "DataFrame"
        samples, layout = samples_of(source, None, None, chosen, name)
    elif not isinstance(source, str | os.PathLike):
        raise InputError(f"log: expected a path or a DataFrame, found {type(source).__name__}")
    else:
        path, name = Path(source), str(source)
        if path.suffix.lower() in BINARY:
            samples, layout = samples_of(path, None, None, chosen, name)
        else:
            samples, layout = _of_text(path, chosen, strict, remarks)
    if layout.time is None:
        raise FileError(
            f"{name}: no name says which column holds the times; say which by --columns t=NAME"
        )
    return checked_log(samples, layout, name)._replace(remarks=tuple(remarks))


def _of_text(
    path: Path, chosen: Mapping[str, str], strict: bool, remarks: list[str]
) -> tuple[Samples, Layout]:
    """The samples of a CSV file, without lines that cannot be read. Raises FileError."""
    reader = LogReader(str(path), None, None, chosen, strict)
    blocks = [reader.feed(data, last) for data, last in blocks_of(path, LARGEST_TABLE)]
    whole = [block for block in blocks if block.t.size]
    if reader.layout is None or not whole:
        raise FileError(f"{path}: holds no samples")
    samples = Samples(*[np.concatenate(parts) for parts in zip(*whole, strict=True)])
    if reader.unreadable:
        samples = _readable(samples, reader, path)
        remarks.append(
            f"{path}: {counted_lines(reader.unreadable)} cannot be read and count as missing; "
            f"{reader.why}"
        )
    return samples, reader.layout


def _readable(samples: Samples, reader: LogReader, path: Path) -> Samples:
    """The samples of which something could be read. Raises FileError if those are few."""
    if reader.unreadable > MOST_UNREADABLE * samples.t.size:
        raise FileError(
            f"{path}: {counted_lines(reader.unreadable)} of {samples.t.size} cannot be read; "
            f"{reader.why}"
        )
    some = np.isfinite(np.column_stack([samples.t, samples.y, samples.u])).any(axis=1)
    return Samples(*[part[some] for part in samples])


def log_of_arrays(t: Any, u: Any, y: Any) -> Log:
    """A log from arrays.

    Args:
        t: times (N) [s], or one number, the sample time [s].
        u: inputs (N) or (N x m).
        y: readings (N) or (N x p); NaN where one is missing.

    Returns:
        The log.

    Raises:
        InputError: arrays of different lengths, or what is not numeric.
    """
    readings = _rows("y", numbers("y", y, "iuf"))
    moved = _rows("u", numbers("u", u, "iuf"))
    times = numbers("t", t, "iuf")
    if times.ndim == 0:
        times = float(times) * np.arange(len(readings))
    times = times.ravel()
    if not times.size == len(moved) == len(readings):
        raise InputError(
            f"t, u, y: expected as many rows in each, found {times.shape}, {moved.shape},"
            f" {readings.shape}"
        )
    layout = _layout(readings.shape[1], moved.shape[1])
    samples = Samples(times, readings, moved, np.empty(0, np.int64))
    return checked_log(samples, layout, "arrays")


def _layout(p: int, m: int) -> Layout:
    """The layout of arrays."""
    titles = [Title("t", "s")]
    for signal, count in (("y", p), ("u", m)):
        names = [signal] if count == 1 else [f"{signal}[{i}]" for i in range(count)]
        titles += [Title(name, "") for name in names]
    return layout_of_titles(titles, p, m, {}, "arrays")


def _rows(key: str, array: Any) -> Any:
    """An array with a row a sample. Raises InputError."""
    if array.ndim == 1:
        return array[:, None]
    if array.ndim == 2 and 1 in array.shape and array.shape[1] != 1:
        return array.T
    if array.ndim != 2:
        raise InputError(f"{key}: expected a row for each sample, found shape {array.shape}")
    return array
