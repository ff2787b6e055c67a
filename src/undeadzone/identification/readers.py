"""Logs from CSV, .npz, .mat, DataFrames and arrays; nothing in a file is ever executed."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.identification.columns import choose
from undeadzone.identification.csv_table import read_csv
from undeadzone.identification.log import Log, make_log
from undeadzone.logs.column import Column, numbers
from undeadzone.logs.containers import of_frame, of_mat, of_npz


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
        columns, named, name = of_frame(source), True, "DataFrame"
    elif isinstance(source, str | os.PathLike):
        path = Path(source)
        name = str(path)
        suffix = path.suffix.lower()
        if suffix == ".npz":
            columns, named = of_npz(path), True
        elif suffix == ".mat":
            columns, named = of_mat(path), True
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
    readings = numbers("y", y, "iuf")
    moved = numbers("u", u, "iuf")
    times = numbers("t", t, "iuf")
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
