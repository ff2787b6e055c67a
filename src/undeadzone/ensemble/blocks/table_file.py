"""Columns and a header in a file: `.npz`, the same bytes for the same numbers and read as a map, or `.parquet` for other tools."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.support.arrays import Floats
from undeadzone.support.files import reason, replacing

HEADER: Final = "undeadzone"
CHUNK: Final = 2**20  # rows in a row group of Parquet
ZIP_SIZES: Final = (
    26  # where a local header in a zip file holds the lengths of its name and extra field
)


class Table(NamedTuple):
    """header: text; columns: equally long; attached: other arrays."""

    header: str
    columns: Mapping[str, Floats]
    attached: Mapping[str, Floats]


def require(path: Path) -> None:
    """Raise InputError where no table can be written: for another suffix, or where pyarrow is missing."""
    if path.suffix not in (".npz", ".parquet"):
        raise InputError(f"{path}: the name must end in .npz or .parquet")
    if path.suffix == ".parquet":
        _arrow()


def save(table: Table, path: Path) -> Path:
    """Write a table as its suffix says. Raises FileError, InputError."""
    require(path)
    write = _write_parquet if path.suffix == ".parquet" else _write_npz
    write(table, path)
    return path


def load(path: Path) -> Table:
    """Read a table. Raises FileError; InputError where pyarrow is missing."""
    try:
        return _read_parquet(path) if path.suffix == ".parquet" else _read_npz(path)
    except InputError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except (ValueError, KeyError, struct.error, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: not an ensemble saved by undeadzone ({error})") from None


def _write_npz(table: Table, path: Path) -> None:
    arrays: dict[str, Any] = {HEADER: np.frombuffer(table.header.encode(), np.uint8)}
    arrays |= {f"columns/{name}": values for name, values in table.columns.items()}
    arrays |= {
        f"attached/{name}": np.ascontiguousarray(values) for name, values in table.attached.items()
    }
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)


def _read_npz(path: Path) -> Table:
    """Arrays are mapped, not read; but every byte is checked first."""
    found = {}
    with zipfile.ZipFile(path) as archive, open(path, "rb") as file:
        torn = archive.testzip()
        if torn is not None:
            raise ValueError(f"{torn} is damaged")
        for entry in archive.infolist():
            file.seek(entry.header_offset + ZIP_SIZES)
            file.seek(sum(struct.unpack("<HH", file.read(4))), 1)
            np.lib.format.read_magic(file)
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
            found[entry.filename.removesuffix(".npy")] = np.memmap(
                path, dtype, "r", file.tell(), shape, "F" if fortran else "C"
            )
    header = found[HEADER].tobytes().decode()
    columns, attached = (
        {n.removeprefix(kind): v for n, v in found.items() if n.startswith(kind)}
        for kind in ("columns/", "attached/")
    )
    return Table(header, columns, attached)


def _write_parquet(table: Table, path: Path) -> None:
    arrow = _arrow()
    import pyarrow.parquet as parquet

    extra = {
        f"attached/{name}": np.ascontiguousarray(values, "<f8").tobytes()
        for name, values in table.attached.items()
    }
    schema = arrow.schema(
        [(name, arrow.float64()) for name in table.columns], metadata={HEADER: table.header} | extra
    )
    runs = len(next(iter(table.columns.values())))
    with (
        replacing(path) as temporary,
        parquet.ParquetWriter(temporary, schema, compression="zstd") as writer,
    ):
        for start in range(0, runs, CHUNK):
            rows = [
                np.asarray(values[start : start + CHUNK], float)
                for values in table.columns.values()
            ]
            writer.write_table(
                arrow.Table.from_arrays([arrow.array(part) for part in rows], schema=schema)
            )


def _read_parquet(path: Path) -> Table:
    _arrow()
    import pyarrow.parquet as parquet

    table = parquet.read_table(path)
    metadata = {key.decode(): value for key, value in (table.schema.metadata or {}).items()}
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    attached = {
        name.removeprefix("attached/"): np.frombuffer(value, "<f8")
        for name, value in metadata.items()
        if name.startswith("attached/")
    }
    return Table(metadata[HEADER].decode(), columns, attached)


def _arrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        raise InputError(
            "a .parquet file needs pyarrow: pip install 'undeadzone[parquet]', or name it .npz"
        ) from None
    return pyarrow
