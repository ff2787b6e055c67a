"""Columns from .npz and .mat files and from DataFrames; nothing in a file is ever executed."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from undeadzone.errors import FileError
from undeadzone.logs.column import Column, split_unit
from undeadzone.support.files import (
    LARGEST_RUN,
    LARGEST_TABLE,
    reason,
    require_plain,
    require_unpacked,
)


def of_frame(frame: Any) -> list[Column]:
    """The numeric columns of a DataFrame; times of day become seconds since the first."""
    titled = [(str(title), np.asarray(frame[title])) for title in frame.columns]
    if frame.index.name is not None:
        titled.insert(0, (str(frame.index.name), np.asarray(frame.index)))
    columns = []
    for title, values in titled:
        name, unit = split_unit(title)
        if values.dtype.kind == "M":
            values = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
        elif values.dtype.kind == "m":
            values = values / np.timedelta64(1, "ns") * 1e-9
        if values.dtype.kind in "iufb":
            columns.append(Column(name, unit, values.astype(float)))
    return columns


def of_npz(path: Path) -> list[Column]:
    """The arrays of an .npz file as columns. Raises FileError."""
    try:
        require_plain(path, LARGEST_RUN)
        require_unpacked(path, LARGEST_RUN)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files if name != "info"}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except Exception as error:  # damaged archives raise whatever their decoders raise
        raise FileError(f"{path}: cannot read: {type(error).__name__}") from None
    return _columns_of(arrays, path)


def of_mat(path: Path) -> list[Column]:
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
    named = {name: array for name, array in arrays.items() if not name.startswith("__")}
    return _columns_of(named, path)


def _columns_of(arrays: dict[str, Any], path: Path) -> list[Column]:
    """Arrays of one length as columns; a matrix gives `u[0]`, `u[1]`, ... Raises FileError."""
    longest = 0
    for array in arrays.values():
        if isinstance(array, np.ndarray) and array.dtype.kind in "iuf" and array.ndim <= 2:
            longest = max(longest, *array.shape, 0)
    columns: list[Column] = []
    for name, array in arrays.items():
        usable = isinstance(array, np.ndarray) and array.dtype.kind in "iuf"
        if not usable or array.ndim not in (1, 2) or longest not in array.shape:
            continue
        flat = array.ndim == 1 or 1 in array.shape
        rows = array.reshape(longest, 1) if flat else array
        if rows.shape[0] != longest:
            rows = rows.T
        for k in range(rows.shape[1]):
            title = name if rows.shape[1] == 1 else f"{name}[{k}]"
            columns.append(Column(title, "", rows[:, k].astype(float)))
    if not columns:
        raise FileError(f"{path}: holds no arrays of numbers; it should hold t, y and u")
    return columns
