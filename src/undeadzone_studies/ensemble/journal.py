"""Rows on disk, block by block: a job stopped at any moment (Ctrl-C, kill -9, power) can go on.

One file holds a header that describes the job, then the columns one after the other, then a
checksum for each block, written after its rows. A block counts as done if its checksum is that of
its rows. So no torn or lost block is trusted.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError, ShapeError
from undeadzone.util.answers import load_saved_problem, require_same_problem
from undeadzone.util.arrays import Floats
from undeadzone.util.files import convert_write_errors, lock_file, write_all_bytes
from undeadzone.util.installed import package_versions
from undeadzone_studies.ensemble.job import Layout

PAGE = 4096  # [bytes] the columns begin at a multiple of it
SECTOR = 512  # [bytes] unit in which a system counts the size of a file on disk
NUMBER = 8  # [bytes] of a float64 and of a checksum
OTHER_HEADER = 2**20  # [bytes] that the header of another problem may be longer
WORDS = ("is not an unfinished ensemble", "an unfinished ensemble is there")


class Store(NamedTuple):
    """Open store of rows, locked against other processes.

    Attributes:
        path: of its file
        layout: of the rows
        file: open for reading and writing
        start: first byte of the columns [bytes]
        done: which blocks it holds
    """

    path: Path
    layout: Layout
    file: io.FileIO
    start: int
    done: npt.NDArray[np.bool_]

    @property
    def missing_blocks(self) -> list[int]:
        """Return the blocks that the store does not contain yet."""
        return np.flatnonzero(~self.done).tolist()

    @property
    def runs_done(self) -> int:
        """Return the number of runs in the store."""
        blocks = np.flatnonzero(self.done).tolist()
        return sum(len(self.layout.runs_in_block(block)) for block in blocks)

    def write_block(self, block: int, rows: Floats) -> None:
        """Write the rows of a block (its runs x columns), with their checksum.

        Raises ShapeError, and FileError (disk full, file removed).
        """
        count = len(self.layout.runs_in_block(block))
        width = len(self.layout.columns)
        if rows.shape != (count, width):
            shape = " x ".join(map(str, rows.shape))
            raise ShapeError(f"block {block}: expected {count} x {width}, found {shape}")
        columns = np.ascontiguousarray(rows.T, "<f8")
        for column, offset in zip(columns, self._block_offsets(block), strict=True):
            write_all_bytes(self.path, self.file, column.tobytes(), offset)
        checksum = _block_checksum(block, columns.tobytes())
        write_all_bytes(self.path, self.file, checksum, self._checksum_offset + block * NUMBER)
        self.done[block] = True

    def map_columns(self) -> dict[str, Floats]:
        """Return the columns by name (runs each), read from the file as they are used.

        Raises InputError while blocks are missing.
        """
        layout = self.layout
        if not self.done.all():
            left = f"{layout.runs - self.runs_done} of {layout.runs} runs"
            raise InputError(f"{self.path}: {left} are missing. Resume it first")
        shape = (len(layout.columns), layout.runs)
        numbers = np.memmap(self.file, "<f8", "r", self.start, shape)
        return dict(zip(layout.columns, numbers, strict=True))

    @property
    def size_in_bytes(self) -> int:
        """Return the size of the complete file [bytes]."""
        return self._checksum_offset + self.layout.number_of_blocks * NUMBER

    def verify_blocks(self) -> Store:
        """Return the store with the blocks whose rows match their checksum marked as done."""
        checksums = _read_bytes(
            self.file, self._checksum_offset, self.layout.number_of_blocks * NUMBER
        )
        done = np.zeros(self.layout.number_of_blocks, bool)
        for block in np.flatnonzero(np.frombuffer(checksums, "<u8")).tolist():
            size = len(self.layout.runs_in_block(block)) * NUMBER
            rows = b"".join(
                _read_bytes(self.file, offset, size) for offset in self._block_offsets(block)
            )
            stored = checksums[block * NUMBER : (block + 1) * NUMBER]
            done[block] = _block_checksum(block, rows) == stored
        return self._replace(done=done)

    @property
    def _checksum_offset(self) -> int:
        """Return the offset of the checksums in the file [bytes]."""
        return self.start + len(self.layout.columns) * self.layout.runs * NUMBER

    def _block_offsets(self, block: int) -> range:
        """Return the offsets of the numbers of a block in each column [bytes]."""
        first = self.start + self.layout.runs_in_block(block).start * NUMBER
        return range(first, first + self._checksum_offset - self.start, self.layout.runs * NUMBER)

    def close(self) -> None:
        """Close and unlock. The file stays."""
        self.file.close()

    def remove(self) -> None:
        """Delete the file, its results being kept elsewhere."""
        with convert_write_errors(self.path):
            self.path.unlink(missing_ok=True)
        self.close()


def open_store(path: Path, layout: Layout, resume: bool = False) -> Store:
    """Open a store, or create it if the file does not exist.

    Args:
        path: of its file
        layout: of the rows
        resume: take up what an earlier run left there

    Raises:
        FileError: if it cannot be written, another process uses it, the file is something else, or
            it is there and `resume` is not set
        InputError: if it holds another problem
    """
    header = _build_header(layout)
    with lock_file(path, "r+") as file:
        there = _read_bytes(file, 0, len(header) + OTHER_HEADER)
        fresh = not there.strip(b"\0")
        if not fresh:
            problem = load_saved_problem(path, _header_line(there), "ensemble", WORDS, resume)
            require_same_problem(path, problem, json.loads(_header_line(header)))
        store = Store(path, layout, file, len(header), np.empty(0, bool))
        with convert_write_errors(path):
            _set_size(path, file, store.size_in_bytes, fresh)
            if fresh:
                write_all_bytes(path, file, header, 0)
            return store.verify_blocks()


def _build_header(layout: Layout) -> bytes:
    """Return the data that determine the numbers, as a line of JSON in whole pages."""
    shape = layout._asdict()
    problem = shape.pop("problem")
    line = json.dumps({"ensemble": 1, **shape, **problem, **package_versions()}).encode() + b"\n"
    pages = -(-len(line) // PAGE)
    return line.ljust(pages * PAGE, b"\0")


def _header_line(beginning: bytes) -> bytes:
    """Return the line of JSON with which a file begins."""
    return beginning.partition(b"\n")[0]


def _block_checksum(block: int, data: bytes) -> bytes:
    """Return the checksum of the rows of a block, which depends on its number, too."""
    return hashlib.blake2b(data, digest_size=NUMBER, salt=block.to_bytes(16, "little")).digest()


def _set_size(path: Path, file: io.FileIO, size: int, fresh: bool) -> None:
    """Give a file its size at the end, which takes disk space only as blocks are written.

    A disk that is too small is noticed now, before hours of work.
    """
    try:
        if fresh:
            file.truncate(0)
        file.truncate(size)
        if hasattr(os, "fstatvfs"):
            disk = os.fstatvfs(file.fileno())
            allocated = os.fstat(file.fileno()).st_blocks * SECTOR
            free = disk.f_bavail * disk.f_frsize
            if size - allocated > free:
                raise OSError(f"it needs {size / 1e6:,.0f} MB, and the disk has {free / 1e6:,.0f}")
    except BaseException:
        if fresh:
            path.unlink(missing_ok=True)
        raise


def _read_bytes(file: io.FileIO, offset: int, size: int) -> bytes:
    """Return `size` bytes of a file, or fewer at its end."""
    file.seek(offset)
    return file.read(size)
