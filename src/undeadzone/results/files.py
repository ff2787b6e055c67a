"""What a run and the estimates of a log have in common: signals as attributes, a table, files.

Files hold signals with their info, exactly as they were.
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final, Self

import msgspec
import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.results.signals import Layout, Signals, from_columns, output_names, unit_of
from undeadzone.support import files
from undeadzone.support.arrays import Floats
from undeadzone.support.files import LARGEST_RUN, Name, path_of, reason, replacing
from undeadzone.support.shown import Shown
from undeadzone.support.text import json_line, printable

CHECKSUM: Final = '"sha256":"'  # the last key of the info in a `.csv`
DIGITS: Final = 20  # bytes of a number in a `.csv`, about
NO_SUM: Final = 64 * "0"

# What NumPy, msgspec and the zip file around them raise of a file that is no run.
NOT_A_RUN: Final = (*files.NO_ARRAYS, StopIteration, msgspec.DecodeError)


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Recorded(Shown):
    """A result with signals, one row per sample; each is an attribute, None where there is none.

    Args:
        info: what is known besides the signals.
        signals: by name; None: those that are given alone.
        given: signals in their place, or besides them.

    Attributes:
        signals: all of them by name.
        info: what is known besides the signals.
        layout: which signals such a result may have.
        kind: of its info.
    """

    signals: Signals
    info: Any
    layout: ClassVar[Layout]
    kind: ClassVar[type[msgspec.Struct]]

    def __init__(self, info: Any, signals: Signals | None = None, **given: Floats | None) -> None:
        before = {} if signals is None else signals.arrays
        object.__setattr__(self, "info", info)
        object.__setattr__(self, "signals", Signals(self.layout, {**before, **given}))

    def __dir__(self) -> list[str]:
        """The names of attributes, signals among them."""
        return [*object.__dir__(self), *self.layout.names]

    def __getattr__(self, name: str) -> Any:
        """A signal by name, None where there is none. Raises AttributeError."""
        if name not in type(self).layout.names:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return self.signals.arrays.get(name)

    @property
    def outputs(self) -> list[str]:
        """The names of the outputs: an arm's joints where it has one for each, else numbers."""
        return output_names(self.info.joints, self.y.shape[1])

    def columns(self) -> dict[str, Floats]:
        """Every scalar signal by column name: t, y[0], ..., d_right[0], d_left[0], ..., V."""
        return self.signals.columns()

    def unit(self, name: str) -> str:
        """The unit of a signal or of one of its columns.

        Args:
            name: of the signal, `x_hat`, or of the column, `x_hat[0]`.
        """
        return unit_of(name, self.info.units)

    def to_pandas(self) -> Any:
        """A pandas DataFrame indexed by t, one column per scalar signal; needs pandas."""
        import pandas as pd

        table = self.columns()
        t = pd.Index(table.pop("t"), name="t")
        return pd.DataFrame(table, index=t)

    @property
    def table_size(self) -> float:
        """About how many bytes its `.csv` has."""
        return DIGITS * sum(float(column.size) for column in self.columns().values())

    def save(self, path: Name) -> Path:
        """Write the signals to a file.

        Args:
            path: ending in `.npz`, or in `.csv` (17 digits, units in the header, the info as a
                first line after #).

        Returns:
            The path.

        Raises:
            FileError: it cannot be written.
            InputError: the name ends otherwise.
        """
        path, info = path_of(path), untimed(self.info)
        if path.suffix == ".npz":
            _write_npz(path, info, self.signals.arrays)
        elif path.suffix == ".csv":
            _write_csv(path, info, self.columns())
        else:
            raise InputError(f"{path}: the name must end in .npz or .csv")
        return path

    @classmethod
    def load(cls, path: Name) -> Self:
        """Read a result saved as `.npz` or `.csv`, exactly as it was.

        Args:
            path: of the file.

        Raises:
            FileError: it cannot be read, or holds no such result.
        """
        path = path_of(path)
        try:
            if path.suffix == ".csv":
                files.require_plain(path, LARGEST_RUN)
                info, table = _read_csv(path, cls.kind)
                return cls(info, None, **from_columns(table, cls.layout))
            arrays = files.arrays_of(path, LARGEST_RUN)
            info = msgspec.json.decode(arrays["info"].tobytes(), type=cls.kind)
            given = {name: arrays[name] for name in cls.layout.names if name in arrays}
            return cls(info, None, **given)
        except OSError as error:
            raise FileError(f"{path}: cannot read: {reason(error)}") from None
        except NOT_A_RUN as error:
            raise FileError(f"{path}: not a run saved by undeadzone ({error})") from None


def untimed(info: Any) -> Any:
    """An info without the time that it took, so that equal runs have equal files."""
    return msgspec.structs.replace(info, seconds=0.0) if hasattr(info, "seconds") else info


def _write_npz(path: Path, info: Any, signals: Mapping[str, Floats]) -> None:
    """Write signals compressed."""
    head = np.frombuffer(msgspec.json.encode(info), np.uint8)
    arrays: dict[str, Any] = {"info": head, **signals}
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def _write_csv(path: Path, info: Any, table: Mapping[str, Floats]) -> None:
    """Write columns with 17 digits: the info after #, names with units, numbers.

    The info ends with a checksum of the whole file, in which zeros stand in its own place.
    """
    units = [" ".join(unit_of(name, info.units).split()) for name in table]
    heads = [f"{name} [{printable(unit)}]" for name, unit in zip(table, units, strict=True)]
    numbers = np.stack(list(table.values()), axis=1)
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
