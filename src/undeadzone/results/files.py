"""Result of a run or of a log: signals with their info, its table, and its files, exact to the
last bit.
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, ClassVar, Final

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.results.signals import Layout, Signals, signal_unit, signals_from_columns
from undeadzone.util import files, shown
from undeadzone.util.arrays import Floats
from undeadzone.util.files import LARGEST_RUN, Name, replace_file, to_path
from undeadzone.util.text import escape_controls, escape_json_controls

CHECKSUM: Final = '"sha256":"'  # the last key of the info in a `.csv`
DIGITS: Final = 20  # bytes of a number in a `.csv`, about
NO_SUM: Final = 64 * "0"


@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class SignalResult:
    """Signals, which are attributes by name, and the facts about them.

    Attributes:
        signals: all of them by name.
        info: facts besides the signals.
    """

    signals: Signals
    info: Any

    layout: ClassVar[Layout]

    def __init__(self, info: Any, signals: Signals | None = None, **given: Floats | None) -> None:
        """Keep the signals.

        Args:
            info: facts besides the signals.
            signals: by name (None: those given as keywords).
            given: signals in their place, or besides them.
        """
        before = {} if signals is None else signals.arrays
        object.__setattr__(self, "info", info)
        object.__setattr__(self, "signals", Signals(self.layout, {**before, **given}))

    def __getattr__(self, name: str) -> Any:
        """Return a signal by name, None if the result lacks it.

        Raises:
            AttributeError: such a result cannot have it.
        """
        if name not in self.layout.names:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return self.signals.arrays.get(name)

    def __dir__(self) -> list[str]:
        """Return the names of attributes, signals included."""
        return [*object.__dir__(self), *self.layout.names]

    __repr__ = shown.format_result
    _repr_html_ = shown.result_to_html

    plot = shown.plot
    """Draw it."""

    def columns(self) -> dict[str, Floats]:
        """Return every scalar signal by column name: t, y[0], ..., d_right[0], ..., V."""
        return self.signals.columns()

    def unit(self, name: str) -> str:
        """Return the unit of a signal or of a column.

        Args:
            name: of the signal, `x_hat`, or of the column, `x_hat[0]`.
        """
        return signal_unit(name, self.info.units)

    def to_pandas(self) -> Any:
        """Return a pandas DataFrame indexed by t, a column per scalar signal (needs pandas)."""
        import pandas as pd

        table = self.columns()
        t = pd.Index(table.pop("t"), name="t")
        return pd.DataFrame(table, index=t)

    @property
    def table_size(self) -> float:
        """Return the approximate size of the `.csv` [bytes]."""
        return DIGITS * sum(float(column.size) for column in self.columns().values())

    def save(self, path: Name) -> Path:
        """Write the signals to a file and return its path.

        Args:
            path: ending in `.npz`, or in `.csv` (17 digits, units in the header, the info as a
                first line after #).

        Returns:
            The path.

        Raises:
            FileError: it cannot be written.
            InputError: the name ends otherwise.
        """
        path = to_path(path)
        info = drop_computing_time(self.info)
        if path.suffix == ".npz":
            _write_npz(path, info, self.signals.arrays)
        elif path.suffix == ".csv":
            _write_csv(path, info, self.columns())
        else:
            raise InputError(f"{path}: the name must end in .npz or .csv")
        return path


def drop_computing_time(info: Any) -> Any:
    """Return an info without the computing time, so that equal runs have equal files."""
    return msgspec.structs.replace(info, seconds=0.0) if hasattr(info, "seconds") else info


def read_result(path: Name, layout: Layout, kind: type[msgspec.Struct]) -> tuple[Any, Signals]:
    """Return the info and the signals of a result. Raises FileError.

    Args:
        path: of a file that `save` wrote.
        layout: of the signals.
        kind: of the info.
    """
    path = to_path(path)
    with files.convert_read_errors(path, "not a run saved by undeadzone"):
        if path.suffix == ".csv":
            info, table = _read_csv(path, kind)
            return info, Signals(layout, signals_from_columns(table, layout))
        arrays = files.load_arrays(path, LARGEST_RUN)
        info = msgspec.json.decode(arrays["info"].tobytes(), type=kind)
        signals = {name: arrays[name] for name in layout.names if name in arrays}
        return info, Signals(layout, signals)


def _write_npz(path: Path, info: Any, signals: Mapping[str, Floats]) -> None:
    """Write the info and the signals to a compressed `.npz`."""
    head = np.frombuffer(msgspec.json.encode(info), np.uint8)
    arrays: dict[str, Any] = {"info": head, **signals}
    with replace_file(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def _write_csv(path: Path, info: Any, table: Mapping[str, Floats]) -> None:
    """Write columns with 17 digits: the info after #, names with units, numbers.

    The info ends with a checksum of the whole file, in which zeros stand in its own place.
    """
    units = [" ".join(signal_unit(name, info.units).split()) for name in table]
    heads = [f"{name} [{escape_controls(unit)}]" for name, unit in zip(table, units, strict=True)]
    numbers = np.stack(list(table.values()), axis=1)
    entries = escape_json_controls(msgspec.json.encode(info).decode()).removesuffix("}")
    first = f'# {entries},{CHECKSUM}{NO_SUM}"}}\n'
    with replace_file(path) as temporary:
        with open(temporary, "w", encoding="utf-8", newline="") as file:
            file.write(first)
            csv.writer(file, lineterminator="\n").writerow(heads)
            np.savetxt(file, numbers, fmt="%.17g", delimiter=",")
        with open(temporary, "r+b") as written:
            digest = hashlib.file_digest(written, "sha256").hexdigest()
            written.seek(0)
            written.write(first.replace(NO_SUM, digest).encode())


def _read_csv(path: Path, kind: type[msgspec.Struct]) -> tuple[Any, dict[str, Floats]]:
    """Return the info and the columns of a table."""
    with (
        files.open_plain(path, LARGEST_RUN) as opened,
        io.TextIOWrapper(opened, "utf-8", newline="") as file,
    ):
        _require_checksum(opened)
        info = msgspec.json.decode(file.readline().removeprefix("# "), type=kind)
        heads = next(csv.reader([file.readline()]))
        rows = file.readlines()
    if not rows:
        raise ValueError("no samples")
    names = [head.partition(" [")[0] for head in heads]
    table = np.loadtxt(rows, delimiter=",", ndmin=2)
    return info, dict(zip(names, table.T, strict=True))


def is_own_table(path: Path) -> bool:
    """Return whether a `.csv` file is as `save` wrote it."""
    try:
        with files.open_plain(path, LARGEST_RUN) as file:
            _require_checksum(file)
            return CHECKSUM.encode() in file.readline()
    except (OSError, ValueError):
        return False


def _require_checksum(file: BinaryIO) -> None:
    """Raise ValueError if a table was changed or cut. Older tables have no checksum.

    The file stands at its beginning afterwards.
    """
    first = file.readline()
    start = first.rfind(CHECKSUM.encode()) + len(CHECKSUM)
    end = start + len(NO_SUM)
    digest = hashlib.sha256(first[:start] + NO_SUM.encode() + first[end:])
    while chunk := file.read(2**20):
        digest.update(chunk)
    file.seek(0)
    if CHECKSUM.encode() not in first:
        return
    if first[start:end] != digest.hexdigest().encode():
        raise ValueError("its checksum is not that of its contents: it was changed or cut")
