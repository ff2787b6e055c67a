"""The files of a run: signals with their info, as `.npz` or `.csv`, exactly as they were."""

from __future__ import annotations

import csv
import zipfile
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.simulation.run_columns import from_columns, to_columns, unit_of
from undeadzone.simulation.run_info import Info
from undeadzone.support.arrays import Floats
from undeadzone.support.files import reason, replacing

# What NumPy, msgspec and the zip file around them raise of a file that is no run.
NOT_A_RUN: Final = (
    ValueError,
    KeyError,
    TypeError,
    StopIteration,
    EOFError,
    msgspec.DecodeError,
    zipfile.BadZipFile,
    zlib.error,
)


def write(path: Path, info: Info, signals: Mapping[str, Floats]) -> Path:
    """Write signals by name. Raises FileError; InputError for a name of another ending."""
    if path.suffix == ".npz":
        _write_npz(path, info, signals)
    elif path.suffix == ".csv":
        _write_csv(path, info, to_columns(signals))
    else:
        raise InputError(f"{path}: the name must end in .npz or .csv")
    return path


def read(path: Path, signals: Iterable[str], required: Iterable[str]) -> dict[str, Any]:
    """The info and the signals of a run. Raises FileError.

    Args:
        path: of a file that `write` wrote.
        signals: names of all signals that there may be.
        required: of those without which there is no run.
    """
    try:
        if path.suffix == ".csv":
            info, columns = _read_csv(path)
            return {"info": info, **from_columns(columns, signals, required)}
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in signals if name in file}
            info = msgspec.json.decode(file["info"].tobytes(), type=Info)
        missing = set(required) - {"V"} - arrays.keys()
        if missing:
            raise ValueError(f"{min(missing)} is missing")
        return {"info": info, "V": None, **arrays}
    except OSError as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except NOT_A_RUN as error:
        raise FileError(f"{path}: not a run saved by undeadzone ({error})") from None


def _write_npz(path: Path, info: Info, signals: Mapping[str, Floats]) -> None:
    """Write signals compressed."""
    arrays: dict[str, Any] = {
        "info": np.frombuffer(msgspec.json.encode(info), np.uint8),
        **signals,
    }
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def _write_csv(path: Path, info: Info, columns: Mapping[str, Floats]) -> None:
    """Write columns with 17 digits: the info after #, names with units, numbers."""
    heads = [f"{name} [{' '.join(unit_of(name, info.units).split())}]" for name in columns]
    numbers = np.stack(list(columns.values()), axis=1)
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write(f"# {msgspec.json.encode(info).decode()}\n")
        csv.writer(file, lineterminator="\n").writerow(heads)
        np.savetxt(file, numbers, fmt="%.17g", delimiter=",")


def _read_csv(path: Path) -> tuple[Info, dict[str, Floats]]:
    """The info and the columns of a table."""
    with open(path, encoding="utf-8", newline="") as file:
        info = msgspec.json.decode(file.readline().removeprefix("# "), type=Info)
        heads = next(csv.reader([file.readline()]))
        rows = file.readlines()
    if not rows:
        raise ValueError("no samples")
    names = [head.partition(" [")[0] for head in heads]
    table = np.loadtxt(rows, delimiter=",", ndmin=2)
    return info, dict(zip(names, table.T, strict=True))
