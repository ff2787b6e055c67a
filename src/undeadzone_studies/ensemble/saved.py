"""Files of ensembles, `.npz` or `.parquet`: columns and metadata.

An `.npz` has the same bytes for the same numbers and is read as a map. A `.parquet` is for other
tools.
"""

from __future__ import annotations

import hashlib
import struct
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.scenario.schema import Units
from undeadzone.util.arrays import Floats
from undeadzone.util.files import Name, convert_read_errors, open_plain, replace_file, to_path
from undeadzone_studies.ensemble.metrics import Bands

HEADER: Final = "undeadzone"
COLUMNS: Final = "columns/"  # what names of arrays in an `.npz` begin with
ATTACHED: Final = "attached/"
CHECKSUM: Final = "digest"  # of names and metadata of a `.parquet`, whose pages have their own
CHUNK: Final = 2**20  # rows in a row group of Parquet
ZIP_SIZES: Final = 26  # offset of the lengths of name and extra field in a zip file's local header
IN_OUTPUT_UNIT: Final = (
    *("rms_", "peak_", "d_", "sensor.right", "sensor.left", "sensor.noise", "reference.amplitude"),
)
Columns = dict[str, Floats]  # by name


def require_ensemble_path(path: Name) -> Path:
    """Return the path if a table can be written to it.

    Raises InputError for another suffix than .npz or .parquet, and without pyarrow for the latter.
    """
    path = to_path(path)
    if path.suffix not in (".npz", ".parquet"):
        raise InputError(f"{path}: the name must end in .npz or .parquet")
    if path.suffix == ".parquet":
        _require_arrow()
    return path


def _write_npz(path: Path, header: str, columns: Columns, attached: Columns) -> None:
    """Write a header, equally long columns and other arrays, each as a member of a zip file."""
    arrays: dict[str, Any] = {HEADER: np.frombuffer(header.encode(), np.uint8)}
    for name, values in columns.items():
        arrays[COLUMNS + name] = values
    for name, values in attached.items():
        arrays[ATTACHED + name] = np.ascontiguousarray(values)
    with replace_file(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, **arrays)


def _load_npz(file: BinaryIO) -> tuple[str, Columns, Columns]:
    """Return header, columns and arrays of `_write_npz`, mapped instead of read.

    Every byte is checked first.
    """
    arrays = {}
    with zipfile.ZipFile(file) as archive:
        torn = archive.testzip()
        if torn is not None:
            raise ValueError(f"{torn} is damaged")
        for entry in archive.infolist():
            arrays[entry.filename.removesuffix(".npy")] = _map_member(file, entry.header_offset)
    header = arrays[HEADER].tobytes().decode()
    return header, _select_arrays(COLUMNS, arrays), _select_arrays(ATTACHED, arrays)


def _map_member(file: BinaryIO, offset: int) -> Any:
    """Return the array of an uncompressed member of a zip file, as a map (offset: of its local
    header).
    """
    file.seek(offset + ZIP_SIZES)
    name_size, extra_size = struct.unpack("<HH", file.read(4))
    file.seek(name_size + extra_size, 1)
    np.lib.format.read_magic(file)
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    return np.memmap(file, dtype, "r", file.tell(), shape, "F" if fortran else "C")


def _select_arrays(kind: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arrays of one kind, by their own names."""
    names = [name for name in arrays if name.startswith(kind)]
    return {name.removeprefix(kind): arrays[name] for name in names}


def _write_parquet(path: Path, header: str, columns: Columns, attached: Columns) -> None:
    """Write the columns as Parquet, with header and other arrays as its metadata."""
    arrow = _require_arrow()
    import pyarrow.parquet as parquet

    metadata: dict[str, str | bytes] = {HEADER: header}
    for name, values in attached.items():
        metadata[ATTACHED + name] = np.ascontiguousarray(values, "<f8").tobytes()
    metadata[CHECKSUM] = _metadata_checksum(metadata, list(columns))
    schema = arrow.schema([(name, arrow.float64()) for name in columns], metadata=metadata)
    runs = len(next(iter(columns.values())))
    with (
        replace_file(path) as temporary,
        parquet.ParquetWriter(
            temporary, schema, compression="zstd", write_page_checksum=True
        ) as writer,
    ):
        for start in range(0, runs, CHUNK):
            chunks = [column[start : start + CHUNK] for column in columns.values()]
            parts = [arrow.array(np.asarray(chunk, float)) for chunk in chunks]
            writer.write_table(arrow.Table.from_arrays(parts, schema=schema))


def _load_parquet(file: BinaryIO) -> tuple[str, Columns, Columns]:
    """Return the columns in memory, header and other arrays from the metadata."""
    _require_arrow()
    import pyarrow.parquet as parquet

    table = parquet.read_table(file, page_checksum_verification=True)
    metadata = {key.decode(): value for key, value in (table.schema.metadata or {}).items()}
    digest = metadata.pop(CHECKSUM, None)  # earlier versions wrote none
    if digest is not None and digest.decode() != _metadata_checksum(metadata, table.column_names):
        raise ValueError("its header or the names of its columns were changed")
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    attached = {}
    for name, value in _select_arrays(ATTACHED, metadata).items():
        attached[name] = np.frombuffer(value, "<f8")
    return metadata[HEADER].decode(), columns, attached


def _metadata_checksum(metadata: Mapping[str, str | bytes], columns: Sequence[str]) -> str:
    """Return the checksum of metadata and column names. Metadata of other programs does not
    count.

    Args:
        metadata: by name.
        columns: their names.
    """
    digest = hashlib.blake2b(repr(list(columns)).encode(), digest_size=16)
    for name in sorted(metadata):
        if name == HEADER or name.startswith(ATTACHED):
            value = metadata[name]
            content = value.encode() if isinstance(value, str) else value
            digest.update(f"{name} {len(content)} ".encode() + content)
    return digest.hexdigest()


def _require_arrow() -> Any:
    """Return the package pyarrow. Raises InputError if it is missing."""
    try:
        import pyarrow
    except ImportError:
        raise InputError(
            "a .parquet file needs pyarrow: pip install 'undeadzone[parquet]', or name it .npz"
        ) from None
    return pyarrow


class Info(msgspec.Struct, frozen=True, kw_only=True):
    """Metadata of an ensemble besides its columns.

    Attributes:
        title: of the scenario
        method: of the observer
        time: "continuous" or "sampled"
        step: time step [s]
        duration: of a run [s]
        seed: of the values and of the noise
        sampling: how the values were drawn
        runs: number of runs
        tolerance: of |z - r| for settling, as a share of the largest |r|
        tracked: the outputs that follow a reference
        widths: the nominal right and left width of each output in turn (2p)
        geared: whether these are the gaps of an arm's gears
        scenario: the scenario as TOML (with a run's number it replays the run)
        version: of undeadzone
        recorded: number of the first runs, those behind the bands
        numbers: a digest of what all runs share
        units: of output and input
    """

    title: str
    method: str
    time: str
    step: float
    duration: float
    seed: int
    sampling: str
    runs: int
    tolerance: float
    tracked: list[int]
    widths: list[float]
    scenario: str
    version: str
    geared: bool = False
    recorded: int = 0
    numbers: str = ""
    units: Units = Units()


def unit_of_column(name: str, units: Units) -> str:
    """Return the unit of a column, or 1 if it is not known (units: of output and input)."""
    if name.endswith("(relative)"):
        return "1"
    stem = name.partition("[")[0]
    known = {"settling_time": "s", "rms_input": units.input, "rms_tip": "m"}
    if stem in known:
        return known[stem]
    return units.output if stem.startswith(IN_OUTPUT_UNIT) else "1"


class _Header(msgspec.Struct, frozen=True):
    """Header of a file about its columns.

    Attributes:
        info: of the ensemble
        varied: the columns that are varied entries
    """

    info: Info
    varied: list[str]


def save_ensemble_file(
    path: Name, varied: Columns, metrics: Columns, info: Info, bands: Bands | None
) -> Path:
    """Write a file with a row for each run, in the format of its suffix.

    Raises FileError, InputError.
    """
    path = require_ensemble_path(path)
    header = msgspec.json.encode(_Header(info, list(varied))).decode()
    attached = {} if bands is None else {"t": bands.t, **bands.quantiles}
    put = _write_parquet if path.suffix == ".parquet" else _write_npz
    put(path, header, {**varied, **metrics}, attached)
    return path


def read_ensemble(path: Name) -> tuple[Columns, Columns, Info, Bands | None]:
    """Return the fields of an ensemble. Raises FileError, InputError if pyarrow is missing."""
    path = to_path(path)
    with convert_read_errors(path, "not an ensemble saved by undeadzone"):
        get = _load_parquet if path.suffix == ".parquet" else _load_npz
        with open_plain(path) as file:
            text, columns, attached = get(file)
        header = msgspec.json.decode(text, type=_Header)
        varied = {name: columns[name] for name in header.varied}
    metrics = {name: column for name, column in columns.items() if name not in varied}
    return varied, metrics, header.info, _extract_bands(attached)


def _extract_bands(attached: Mapping[str, Floats]) -> Bands | None:
    """Return the bands among the further arrays of a file, or None."""
    if "t" not in attached:
        return None
    t = attached["t"]
    names = [name for name in attached if name != "t"]
    return Bands(t, {name: attached[name].reshape(t.size, -1) for name in names})
