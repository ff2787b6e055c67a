"""Signals in CSV files: time first, then one column per channel."""

from __future__ import annotations

import csv
import io
import math

import numpy as np

from undeadzone.errors import FileError
from undeadzone.support.arrays import Floats
from undeadzone.support.files import LARGEST_TABLE, read_text, reason


def read_csv(key: str, path: str, channels: int) -> tuple[Floats, Floats]:
    """The samples in a CSV file; a header line and lines that start with # are allowed.

    Args:
        key: name of the signal in messages.
        path: the file.
        channels: number of columns beside that of time.

    Returns:
        Times (N) [s] and values (N x channels).

    Raises:
        FileError: the file cannot be read, or holds something else.
    """
    rows = _rows(key, path)
    if rows and all(_number(cell) is None for cell in rows[0]):
        rows = rows[1:]
    if not rows:
        raise FileError(f"{key}.path: {path} holds no samples")
    for number, row in enumerate(rows, 1):
        _require_sample(f"{key}.path: {path}: sample {number}", row, channels)
    table = np.array(rows, float)
    if table.shape[0] < 2 or (np.diff(table[:, 0]) <= 0).any():
        raise FileError(f"{key}.path: {path}: needs two samples or more, with time increasing")
    return table[:, 0], table[:, 1:]


def _rows(key: str, path: str) -> list[list[str]]:
    """The cells of a CSV file without empty lines and comments. Raises FileError."""
    try:
        lines = io.StringIO(read_text(path, LARGEST_TABLE).removeprefix("\ufeff"), newline="")
        return [row for row in csv.reader(lines) if row and not row[0].lstrip().startswith("#")]
    except UnicodeDecodeError:
        raise FileError(f"{key}.path: cannot read {path}: not UTF-8 text") from None
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"{key}.path: cannot read {path}: {reason(error)}") from None


def _require_sample(where: str, row: list[str], channels: int) -> None:
    """Raise FileError unless a row holds a time and as many values as channels, all finite."""
    if len(row) != channels + 1:
        columns = f"{len(row)} column{'s' * (len(row) != 1)}"
        values = f"{channels} value{'s' * (channels != 1)}"
        raise FileError(
            f"{where} has {columns}, expected {channels + 1} "
            f"(time and {values}, separated by commas)"
        )
    # The cell itself is not quoted: the scenario may name a file that is not its author's.
    for column, cell in enumerate(row, 1):
        value = _number(cell)
        if value is None or not math.isfinite(value):
            raise FileError(f"{where} is not all finite numbers: see column {column}")


def _number(text: str) -> float | None:
    """The number in a cell, None where there is something else."""
    try:
        return float(text)
    except ValueError:
        return None
