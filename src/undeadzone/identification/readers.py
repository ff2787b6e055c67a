"""Logs from CSV, .npz, .mat, DataFrames and arrays; nothing in a file is ever executed."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.identification.columns import choose
from undeadzone.identification.csv_table import read_csv
from undeadzone.identification.log import Column, Log, make_log, split_unit
from undeadzone.support.arrays import Floats
from undeadzone.support.files import (
    LARGEST_RUN,
    LARGEST_TABLE,
    reason,
    require_plain,
    require_unpacked,
)


def read_log(
    source: Any, time: str | None = None, inputs: str | None = None, output: str | None = None
) -> Log:
    """The log in a file or DataFrame.

    Args:
        source: path of a CSV, .npz or .mat file, or a pandas DataFrame with the columns.
        time, output: column names; default: the usual ones (t, time; y, output).
        inputs: names of the inputs, several separated by commas; default: u, or u[0], u[1], ...

    Returns:
        The log, its times in seconds.

    Raises:
        FileError: what is wrong, with file, line and column where there are any.
    """
    lines: Any = ()
    if hasattr(source, "columns") and hasattr(source, "index"):
        columns, named, name = _of_frame(source), True, "DataFrame"
    elif isinstance(source, str | os.PathLike):
        path = Path(source)
        name = str(path)
        suffix = path.suffix.lower()
        if suffix == ".npz":
            columns, named = _of_npz(path), True
        elif suffix == ".mat":
            columns, named = _of_mat(path), True
        else:
            table = read_csv(path)
            columns, lines, named = table.columns, table.lines, table.named
    else:
        raise InputError(f"log: expected a path or a DataFrame, found {type(source).__name__}")
    chosen = choose(columns, named, name, time, inputs, output)
    return make_log(chosen.time, chosen.inputs, chosen.output, name, lines)


def log_of_arrays(t: Any, u: Any, y: Any) -> Log:
    """A log from arrays.

    Args:
        t: times (N) [s], or one number, the sample time [s].
        u: inputs (N) or (N x m).
        y: readings (N); NaN where one is missing.

    Returns:
        The log.

    Raises:
        InputError: arrays of different lengths, or what is not numeric.
    """
    readings = _numbers("y", y)
    moved = _numbers("u", u)
    times = _numbers("t", t)
    if readings.ndim == 2 and 1 in readings.shape:
        readings = readings.ravel()
    if readings.ndim != 1:
        raise InputError(f"y: expected one reading per sample, found shape {readings.shape}")
    if moved.ndim == 1:
        moved = moved[:, None]
    if times.ndim == 0:
        times = float(times) * np.arange(readings.size)
    times = times.ravel()
    if moved.ndim != 2 or not times.size == moved.shape[0] == readings.size:
        raise InputError(
            f"t, u, y: expected as many rows in each, found {times.shape}, {moved.shape},"
            f" {readings.shape}"
        )
    names = ["u"] if moved.shape[1] == 1 else [f"u[{k}]" for k in range(moved.shape[1])]
    inputs = []
    for k, name in enumerate(names):
        inputs.append(Column(name, "", moved[:, k]))
    return make_log(Column("t", "s", times), inputs, Column("y", "", readings), "arrays")


def _numbers(key: str, value: Any) -> Floats:
    """An array of floats. Raises InputError."""
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(f"{key}: expected numbers in a rectangular list") from None
    if array.dtype.kind not in "iuf":
        raise InputError(f"{key}: expected numbers, found {array.dtype}")
    return array.astype(float)


def _of_frame(frame: Any) -> list[Column]:
    """The numeric columns of a DataFrame; times of day become seconds since the first."""
    columns = []
    for title in frame.columns:
        values = np.asarray(frame[title])
        name, unit = split_unit(str(title))
        if values.dtype.kind == "M":
            values = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
        elif values.dtype.kind == "m":
            values = values / np.timedelta64(1, "ns") * 1e-9
        if values.dtype.kind in "iufb":
            columns.append(Column(name, unit, values.astype(float)))
    return columns


def _of_npz(path: Path) -> list[Column]:
    """The arrays of an .npz file as columns. Raises FileError."""
    try:
        require_plain(path, LARGEST_TABLE)
        require_unpacked(path, LARGEST_RUN)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except Exception as error:  # damaged archives raise whatever their decoders raise
        raise FileError(f"{path}: cannot read: {type(error).__name__}") from None
    return _columns_of(arrays, path)


def _of_mat(path: Path) -> list[Column]:
    """The variables of a .mat file as columns. Raises FileError."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        require_plain(path, LARGEST_TABLE)
        arrays = loadmat(path, mat_dtype=True)
    except NotImplementedError:
        raise FileError(f'{path}: MATLAB 7.3 file; save it with save(..., "-v7")') from None
    except (OSError, MatReadError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except Exception as error:  # damaged files raise whatever their decoders raise
        raise FileError(f"{path}: cannot read: {type(error).__name__}") from None
    return _columns_of({k: v for k, v in arrays.items() if not k.startswith("__")}, path)


def _columns_of(arrays: dict[str, Any], path: Path) -> list[Column]:
    """Arrays of one length as columns; a matrix gives `u[0]`, `u[1]`, ... Raises FileError."""
    longest = 0
    for array in arrays.values():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf":
            longest = max(longest, *array.shape, 0)
    columns: list[Column] = []
    for name, array in arrays.items():
        usable = isinstance(array, np.ndarray) and array.dtype.kind in "iuf"
        if not usable or array.ndim not in (1, 2) or longest not in array.shape:
            continue
        rows = array.reshape(longest, 1) if 1 in array.shape or array.ndim == 1 else array
        if rows.shape[0] != longest:
            rows = rows.T
        for k in range(rows.shape[1]):
            title = name if rows.shape[1] == 1 else f"{name}[{k}]"
            columns.append(Column(title, "", rows[:, k].astype(float)))
    if not columns:
        raise FileError(f"{path}: holds no arrays of numbers; it should hold t, u and y")
    return columns
