"""Columns and a header in a file: `.npz` or `.parquet`.

An `.npz` has the same bytes for the same numbers and is read as a map; a `.parquet` is for other
tools.
"""

from __future__ import annotations

import hashlib
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.support.arrays import Floats
from undeadzone.support.files import reason, replacing, require_plain

HEADER: Final = "undeadzone"
COLUMNS: Final = "columns/"  # what names of arrays in an `.npz` begin with
ATTACHED: Final = "attached/"
CHECKSUM: Final = "checksum"  # of the other metadata of a `.parquet`, whose pages have their own
CHUNK: Final = 2**20  # rows in a row group of Parquet
ZIP_SIZES: Final = 26  # where a zip file's local header holds the lengths of name and extra field


class Table(NamedTuple):
    """What a file holds.

    Attributes:
        header: text
        columns: equally long, by name
        attached: other arrays, by name
    """

    header: str
    columns: Mapping[str, Floats]
    attached: Mapping[str, Floats]


def require(path: Path) -> None:
    """Raise InputError where no table can be written: another suffix, or pyarrow is missing."""
    if path.suffix not in (".npz", ".parquet"):
        raise InputError(f"{path}: the name must end in .npz or .parquet")
    if path.suffix == ".parquet":
        _arrow()


def save(table: Table, path: Path) -> Path:
    """Write a table as its suffix says. Raises FileError, InputError."""
    require(path)
    if path.suffix == ".parquet":
        _write_parquet(table, path)
    else:
        _write_npz(table, path)
    return path


def load(path: Path) -> Table:
    """Read a table. Raises FileError; InputError where pyarrow is missing."""
    try:
        require_plain(path)
        return _read_parquet(path) if path.suffix == ".parquet" else _read_npz(path)
    except InputError:
        raise
    except OSError as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    except (ValueError, KeyError, struct.error, zipfile.BadZipFile) as error:
        raise FileError(f"{path}: not an ensemble saved by undeadzone ({error})") from None


def _write_npz(table: Table, path: Path) -> None:
    """Write the header and every array as a member of a zip file."""
    arrays: dict[str, Any] = {HEADER: np.frombuffer(table.header.encode(), np.uint8)}
    for name, values in table.columns.items():
        arrays[COLUMNS + name] = values
    for name, values in table.attached.items():
        arrays[ATTACHED + name] = np.ascontiguousarray(values)
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)


def _read_npz(path: Path) -> Table:
    """Arrays are mapped, not read; but every byte is checked first."""
    arrays = {}
    with zipfile.ZipFile(path) as archive, open(path, "rb") as file:
        torn = archive.testzip()
        if torn is not None:
            raise ValueError(f"{torn} is damaged")
        for entry in archive.infolist():
            arrays[entry.filename.removesuffix(".npy")] = _mapped(path, file, entry.header_offset)
    header = arrays[HEADER].tobytes().decode()
    return Table(header, _below(COLUMNS, arrays), _below(ATTACHED, arrays))


def _mapped(path: Path, file: BinaryIO, offset: int) -> Any:
    """The array of an uncompressed member of a zip file, as a map; offset: of its local header."""
    file.seek(offset + ZIP_SIZES)
    name_size, extra_size = struct.unpack("<HH", file.read(4))
    file.seek(name_size + extra_size, 1)
    np.lib.format.read_magic(file)
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    return np.memmap(path, dtype, "r", file.tell(), shape, "F" if fortran else "C")


def _below(kind: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays of one kind, by their own names."""
    names = [name for name in arrays if name.startswith(kind)]
    return {name.removeprefix(kind): arrays[name] for name in names}


def _write_parquet(table: Table, path: Path) -> None:
    """Write the columns as Parquet; header and other arrays become its metadata."""
    arrow = _arrow()
    import pyarrow.parquet as parquet

    metadata: dict[str, str | bytes] = {HEADER: table.header}
    for name, values in table.attached.items():
        metadata[ATTACHED + name] = np.ascontiguousarray(values, "<f8").tobytes()
    metadata[CHECKSUM] = _checksum(metadata)
    schema = arrow.schema([(name, arrow.float64()) for name in table.columns], metadata=metadata)
    runs = len(next(iter(table.columns.values())))
    with (
        replacing(path) as temporary,
        parquet.ParquetWriter(
            temporary, schema, compression="zstd", write_page_checksum=True
        ) as writer,
    ):
        for start in range(0, runs, CHUNK):
            chunks = [column[start : start + CHUNK] for column in table.columns.values()]
            parts = [arrow.array(np.asarray(chunk, float)) for chunk in chunks]
            writer.write_table(arrow.Table.from_arrays(parts, schema=schema))


def _read_parquet(path: Path) -> Table:
    """The columns in memory, header and other arrays from the metadata."""
    _arrow()
    import pyarrow.parquet as parquet

    table = parquet.read_table(path, page_checksum_verification=True)
    metadata = {key.decode(): value for key, value in (table.schema.metadata or {}).items()}
    kept = metadata.pop(CHECKSUM, None)  # earlier versions wrote none
    if kept is not None and kept.decode() != _checksum(metadata):
        raise ValueError("its header is damaged")
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    attached = {}
    for name, value in _below(ATTACHED, metadata).items():
        attached[name] = np.frombuffer(value, "<f8")
    return Table(metadata[HEADER].decode(), columns, attached)


def _checksum(metadata: Mapping[str, str | bytes]) -> str:
    """The checksum of metadata; what other programs add to them does not count."""
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(metadata):
        if name == HEADER or name.startswith(ATTACHED):
            value = metadata[name]
            content = value.encode() if isinstance(value, str) else value
            digest.update(f"{name} {len(content)} ".encode() + content)
    return digest.hexdigest()


def _arrow() -> Any:
    """The package pyarrow. Raises InputError where it is missing."""
    try:
        import pyarrow
    except ImportError:
        raise InputError(
            "a .parquet file needs pyarrow: pip install 'undeadzone[parquet]', or name it .npz"
        ) from None
    return pyarrow
