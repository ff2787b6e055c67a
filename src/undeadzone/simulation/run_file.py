"""The files of a run: signals with their info, as `.npz` or `.csv`, exactly as they were."""

from __future__ import annotations

import csv
import hashlib
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
from undeadzone.support.files import LARGEST_RUN, reason, replacing, require_plain, require_unpacked
from undeadzone.support.text import json_line, printable

CHECKSUM: Final = '"sha256":"'  # the last key of the info in a `.csv`
DIGITS: Final = 20  # bytes of a number in a `.csv`, about
NO_SUM: Final = 64 * "0"

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


def write(path: Path, info: Any, signals: Mapping[str, Floats]) -> Path:
    """Write signals by name. Raises FileError; InputError for a name of another ending."""
    if path.suffix == ".npz":
        _write_npz(path, info, signals)
    elif path.suffix == ".csv":
        _write_csv(path, info, to_columns(signals))
    else:
        raise InputError(f"{path}: the name must end in .npz or .csv")
    return path


def table_size(signals: Mapping[str, Floats]) -> float:
    """About how many bytes the `.csv` of signals has."""
    return DIGITS * sum(float(column.size) for column in to_columns(signals).values())


def read(
    path: Path, signals: Iterable[str], required: Iterable[str], kind: type[msgspec.Struct] = Info
) -> dict[str, Any]:
    """The info and the signals of a run. Raises FileError.

    Args:
        path: of a file that `write` wrote.
        signals: names of all signals that there may be.
        required: of those without which there is no run.
        kind: of the info.
    """
    try:
        require_plain(path, LARGEST_RUN)
        if path.suffix == ".csv":
            info, columns = _read_csv(path, kind)
            return {"info": info, **from_columns(columns, signals, required)}
        require_unpacked(path, LARGEST_RUN)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in signals if name in file}
            info = msgspec.json.decode(file["info"].tobytes(), type=kind)
        missing = set(required) - {"V"} - arrays.keys()
        if missing:
            raise ValueError(f"{min(missing)} is missing")
        return {"info": info, "V": None, **arrays}
    except OSError as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except NOT_A_RUN as error:
        raise FileError(f"{path}: not a run saved by undeadzone ({error})") from None


def _write_npz(path: Path, info: Any, signals: Mapping[str, Floats]) -> None:
    """Write signals compressed."""
    arrays: dict[str, Any] = {
        "info": np.frombuffer(msgspec.json.encode(info), np.uint8),
        **signals,
    }
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def _write_csv(path: Path, info: Any, columns: Mapping[str, Floats]) -> None:
    """Write columns with 17 digits: the info after #, names with units, numbers.

    The info ends with a checksum of the whole file, in which zeros stand in its own place.
    """
    units = [" ".join(unit_of(name, info.units).split()) for name in columns]
    heads = [f"{name} [{printable(unit)}]" for name, unit in zip(columns, units, strict=True)]
    numbers = np.stack(list(columns.values()), axis=1)
    entries = json_line(msgspec.json.encode(info).decode()).removesuffix("}")
    first = f'# {entries},{CHECKSUM}{NO_SUM}"}}\n'
    with replacing(path) as temporary:
        with open(temporary, "w", encoding="utf-8", newline="") as file:
            file.write(first)
            csv.writer(file, lineterminator="\n").writerow(heads)
            np.savetxt(file, numbers, fmt="%.17g", delimiter=",")
        with open(temporary, "r+b") as written:
            digest = hashlib.file_digest(written, "sha256").hexdigest()
            written.seek(0)
            written.write(first.replace(NO_SUM, digest).encode())


def _read_csv(path: Path, kind: type[msgspec.Struct]) -> tuple[Any, dict[str, Floats]]:
    """The info and the columns of a table."""
    _require_whole(path)
    with open(path, encoding="utf-8", newline="") as file:
        info = msgspec.json.decode(file.readline().removeprefix("# "), type=kind)
        heads = next(csv.reader([file.readline()]))
        rows = file.readlines()
    if not rows:
        raise ValueError("no samples")
    names = [head.partition(" [")[0] for head in heads]
    table = np.loadtxt(rows, delimiter=",", ndmin=2)
    return info, dict(zip(names, table.T, strict=True))


def _require_whole(path: Path) -> None:
    """Raise ValueError for a table that is not as it was written; older ones have no checksum."""
    with open(path, "rb") as file:
        first = file.readline()
        start = first.rfind(CHECKSUM.encode())
        if start < 0:
            return
        start += len(CHECKSUM)
        end = start + len(NO_SUM)
        digest = hashlib.sha256(first[:start] + NO_SUM.encode() + first[end:])
        while chunk := file.read(2**20):
            digest.update(chunk)
    if first[start:end] != digest.hexdigest().encode():
        raise ValueError("its checksum is not that of its contents: it was changed or cut")
