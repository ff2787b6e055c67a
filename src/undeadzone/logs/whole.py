"""A whole log at once: from .npz, .mat, a DataFrame, or arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.column import Column, Title, numbers
from undeadzone.logs.containers import of_frame, of_mat, of_npz
from undeadzone.logs.dialect import LARGEST
from undeadzone.logs.names import Layout, layout_of_titles
from undeadzone.logs.samples import Samples
from undeadzone.support.arrays import Floats

BINARY: Final = (".npz", ".mat")  # endings of files that are no CSV text


def samples_of(
    log: Any, p: int | None, m: int | None, chosen: Mapping[str, str], source: str
) -> tuple[Samples, Layout]:
    """The samples of a DataFrame, an .npz or a .mat file.

    Args:
        log: the DataFrame, or the path.
        p, m: numbers of readings and inputs that the plant has; None: as many as are named.
        chosen: columns that the user names; see `names.parse_columns`.
        source: the log, for messages.

    Raises:
        FileError: it cannot be read, or a column cannot be told.
    """
    columns = _columns(log)
    if not columns:
        raise FileError(f"{source}: holds no columns of numbers")
    titles = [Title(column.name, column.unit) for column in columns]
    layout = layout_of_titles(titles, p, m, chosen, source)
    length = columns[layout.readings[0]].values.size
    for k in layout.columns:
        if columns[k].values.size != length:
            raise FileError(f"{source}: {titles[k].name!r} has not as many rows as the readings")
    t = np.full(length, np.nan)
    if layout.time is not None:
        t = columns[layout.time].values * (layout.seconds or 1.0)
    y = np.column_stack([columns[k].values for k in layout.readings])
    u = np.column_stack([columns[k].values for k in layout.inputs])
    return _usable(t, y, u), layout


def samples_of_arrays(t: Any, y: Any, u: Any, p: int, m: int, step: float) -> Samples:
    """Samples from arrays.

    Args:
        t: times (N) [s]; None: one step apart.
        y: readings (N) or (N x p), NaN where one is missing.
        u: inputs (N) or (N x m).
        p, m: numbers of readings and inputs that the plant has.
        step: of the scenario [s].

    Raises:
        InputError: an array of another shape, or what is not numeric.
    """
    readings = _rows("y", y, p)
    inputs = _rows("u", u, m)
    if len(readings) != len(inputs):
        raise InputError(f"y, u: expected as many rows, found {len(readings)}, {len(inputs)}")
    if t is None:
        times = step * np.arange(len(readings))
    else:
        times = _rows("t", t, 1)[:, 0]
    if len(times) != len(readings):
        raise InputError(f"t, y: expected as many rows, found {len(times)}, {len(readings)}")
    return _usable(times, readings, inputs)


def _columns(log: Any) -> Sequence[Column]:
    """The columns of numbers of a file or a DataFrame."""
    if isinstance(log, Path):
        return of_npz(log) if log.suffix.lower() == ".npz" else of_mat(log)
    return of_frame(log)


def _usable(t: Floats, y: Floats, u: Floats) -> Samples:
    """Samples whose numbers without meaning are missing."""
    lines = np.arange(1, len(t) + 1)
    return Samples(t, _sensible(y), _sensible(u), lines)


def _sensible(values: Floats) -> Floats:
    """The values, NaN where one is infinite or too large."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) <= LARGEST, values, np.nan)


def _rows(key: str, value: Any, size: int) -> Floats:
    """An array of rows of that size. Raises InputError."""
    rows = numbers(key, value, "iufb")
    if rows.ndim == 1 and size == 1:
        rows = rows[:, None]
    if rows.ndim != 2 or rows.shape[1] != size:
        shape = " x ".join(map(str, rows.shape)) or "one number"
        raise InputError(f"{key}: expected a row of {size} for each sample, found {shape}")
    return rows
