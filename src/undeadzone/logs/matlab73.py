"""Variables of a MATLAB 7.3 file, which is HDF5 with attributes and reversed dimensions.

The file is a stranger's: nothing outside it is opened, and no filter is loaded for it.
"""

from __future__ import annotations

import io
import math
import zlib
from typing import Any, Final

from undeadzone.errors import InputError

SIGNATURE: Final = b"\x89HDF\r\n\x1a\n"
USER_BLOCK: Final = 512  # [bytes] of text ahead of the HDF5 file
DEFLATE: Final = 1  # number of a filter in HDF5
SHUFFLE: Final = 2
FILTERS: Final = ((), (DEFLATE,), (SHUFFLE, DEFLATE))  # sequences that MATLAB and h5py write
PIECE: Final = 1 << 20  # [bytes] unpacked at once
_CLASSES = """
double single logical int8 uint8 int16 uint16 int32 uint32 int64 uint64
"""
NUMERIC: Final = frozenset(_CLASSES.split())


def is_matlab_73(content: bytes) -> bool:
    """Return whether a .mat file is an HDF5 file behind a block of text, or from its first byte."""
    return any(content.startswith(SIGNATURE, start) for start in (0, USER_BLOCK))


def load_matlab_73(content: bytes, most: int) -> dict[str, Any]:
    """Return the real numeric matrices of a MATLAB 7.3 file, by name, as MATLAB shows them.

    A field of a structure has the field's name, with the structure's ahead of it if other
    variables have that name too. Texts, cells, objects, sparse and complex matrices are left out.

    Args:
        content: bytes of the file.
        most: number of elements that its matrices may have, and of bytes that they may unpack to.

    Raises:
        InputError: the package h5py is missing.
        ValueError: the file refers to other files, or its matrices are larger.
    """
    h5py = _require_h5py()
    with h5py.File(io.BytesIO(content), "r") as file:
        found = _list_matrices(h5py, file)
        if sum(matrix.size for matrix in found.values()) > most:
            raise ValueError("its matrices are larger than any log")
        left = most
        for matrix in found.values():
            left -= _count_unpacked(matrix, left)
        fields = [path.rpartition(".")[2] for path in found]
        arrays = {}
        for field, (path, matrix) in zip(fields, found.items(), strict=True):
            arrays[path if fields.count(field) > 1 else field] = matrix[()].T
        return arrays


def unpacked_size(packed: bytes, most: int) -> int:
    """Return the number of bytes that a zlib stream unpacks to; counting ends at `most`.

    Args:
        packed: the stream.
        most: number of bytes.
    """
    reader = zlib.decompressobj()
    count = 0
    while packed and count < most and not reader.eof:
        count += len(reader.decompress(packed, PIECE))
        packed = reader.unconsumed_tail
    return count


def _require_h5py() -> Any:
    """Return the package h5py. Raises InputError if it is missing."""
    try:
        import h5py
    except ImportError:
        raise InputError(
            "a MATLAB 7.3 file needs h5py: pip install 'undeadzone[matlab]', or save it with "
            'save(..., "-v7")'
        ) from None
    return h5py


def _list_matrices(h5py: Any, file: Any) -> dict[str, Any]:
    """Return the datasets of real numeric matrices, those of structures as `name.field`.

    Each group is visited once, so that a group that contains itself has an end.
    """
    found = {}
    open_groups = [("", file)]
    visited = set()
    while open_groups:
        prefix, group = open_groups.pop(0)
        address = h5py.h5o.get_info(group.id).addr
        names = [] if address in visited else list(group)
        visited.add(address)
        for name in names:
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                raise ValueError(f"{name!r} is a link, possibly to another file")
            entry = group[name]
            kind = entry.attrs.get("MATLAB_class", b"")
            if isinstance(entry, h5py.Group):
                if kind == b"struct":
                    open_groups.append((f"{prefix}{name}.", entry))
            elif bytes(kind).decode("latin-1") in NUMERIC and _is_matrix(entry):
                found[prefix + name] = entry
    return found


def _is_matrix(entry: Any) -> bool:
    """Return whether a dataset holds real numbers. Raises ValueError if another file holds them."""
    if entry.external or entry.is_virtual:
        raise ValueError(f"{entry.name!r} is stored in another file")
    is_empty = entry.attrs.get("MATLAB_empty", 0) or not entry.shape
    return not is_empty and entry.dtype.kind in "iuf"


def _count_unpacked(matrix: Any, left: int) -> int:
    """Return the number of bytes that the chunks of a matrix unpack to.

    The sizes that a file declares may lie, so the bytes are counted. Raises ValueError above
    `left`, and for filters that would be loaded from other files.
    """
    settings = matrix.id.get_create_plist()
    filters = tuple(settings.get_filter(k)[0] for k in range(settings.get_nfilters()))
    if filters not in FILTERS:
        raise ValueError(f"{matrix.name!r} has filters that MATLAB does not use")
    if math.prod((matrix.dtype.itemsize, *(matrix.chunks or ()))) > left:
        raise ValueError(f"{matrix.name!r} has parts that are larger than any log")
    count = 0
    if DEFLATE in filters:
        for k in range(matrix.id.get_num_chunks()):
            place = matrix.id.get_chunk_info(k).chunk_offset
            packed = matrix.id.read_direct_chunk(place)[1]
            count += unpacked_size(packed, left - count)
            if count >= left:
                raise ValueError(f"it would unpack to more than {left / 1e6:,.0f} MB")
    return count
