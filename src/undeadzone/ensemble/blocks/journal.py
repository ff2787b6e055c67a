"""Rows on disk, block by block, so that a run that is stopped at any moment (Ctrl-C, kill -9, power) can be continued.

One file: a header that says of what, then the columns one after the other, then a checksum for each block, written after
its rows. A block counts as done if its checksum is that of its rows; so nothing that was torn or lost is ever believed.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.ensemble.blocks.job import Layout, versions
from undeadzone.errors import FileError, InputError, ShapeError
from undeadzone.support.arrays import Floats
from undeadzone.support.files import reason

PAGE = 4096  # [bytes] the columns begin at a multiple of it
NUMBER = 8  # [bytes] of a float64 and of a checksum
OTHER_HEADER = 2**20  # [bytes] that the header of another problem may be longer


class Store(NamedTuple):
    """An open store, locked against other processes; done: which blocks it holds."""

    path: Path
    layout: Layout
    file: io.FileIO
    start: int
    done: npt.NDArray[np.bool_]

    @property
    def missing(self) -> list[int]:
        """The blocks that it does not hold."""
        return [int(block) for block in np.flatnonzero(~self.done)]

    @property
    def runs_done(self) -> int:
        """The number of runs that it holds."""
        last = self.layout.within(self.layout.blocks - 1)
        return int(self.done.sum()) * self.layout.block - int(self.done[-1]) * (
            self.layout.block - (last.stop - last.start)
        )

    def put(self, block: int, rows: Floats) -> None:
        """Keep the rows of a block (its runs x columns). Raises ShapeError, FileError (disk full, file removed)."""
        runs = self.layout.within(block)
        expected = (runs.stop - runs.start, len(self.layout.columns))
        if rows.shape != expected:
            raise ShapeError(
                f"block {block}: expected {expected[0]} x {expected[1]}, found {' x '.join(map(str, rows.shape))}"
            )
        data = np.ascontiguousarray(rows.T, "<f8")
        if not os.fstat(self.file.fileno()).st_nlink:
            raise FileError(f"{self.path}: cannot write: it was removed")
        with _writing(self.path):
            for column, numbers in enumerate(data):
                _write(
                    self.file,
                    self.start + (column * self.layout.runs + runs.start) * NUMBER,
                    numbers.tobytes(),
                )
            _write(
                self.file,
                _checksums(self.start, self.layout) + block * NUMBER,
                _checksum(block, data.tobytes()),
            )
        self.done[block] = True

    def columns(self) -> dict[str, Floats]:
        """The columns by name (runs each), read from the file as they are used. Raises InputError while blocks are missing."""
        if not self.done.all():
            raise InputError(
                f"{self.path}: {self.layout.runs - self.runs_done} of {self.layout.runs} runs are missing; resume it first"
            )
        shape = (len(self.layout.columns), self.layout.runs)
        return dict(
            zip(
                self.layout.columns,
                np.memmap(self.file, "<f8", "r", self.start, shape),
                strict=True,
            )
        )

    def close(self) -> None:
        """Close and unlock; the file stays."""
        self.file.close()

    def remove(self) -> None:
        """Delete the file, its results being kept elsewhere."""
        with _writing(self.path):
            self.path.unlink(missing_ok=True)
        self.close()


def start(path: Path, layout: Layout, resume: bool = False) -> Store:
    """Open a store, or make one where there is none; resume: take up what an earlier run left there.

    Raises FileError where it cannot be written, another process uses it, the file is something else, or it is there and
    `resume` is not set; InputError where it holds another problem.
    """
    header = _header(layout)
    with _writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        file = io.FileIO(
            path, "r+", opener=lambda name, flags: os.open(name, flags | os.O_CREAT, 0o666)
        )
    try:
        _lock(path, file)
        found = _read(file, 0, len(header) + OTHER_HEADER)
        fresh = not found.strip(b"\0")
        if not fresh:
            _check(path, found, header, resume)
        with _writing(path):
            _allocate(path, file, _checksums(len(header), layout) + layout.blocks * NUMBER, fresh)
            if fresh:
                _write(file, 0, header)
            return Store(path, layout, file, len(header), _done(file, len(header), layout))
    except BaseException:
        file.close()
        raise


def _header(layout: Layout) -> bytes:
    words = (
        {"ensemble": 1, "runs": layout.runs, "columns": layout.columns, "block": layout.block}
        | layout.problem
        | versions()
    )
    line = json.dumps(words).encode() + b"\n"
    return line.ljust(-(-len(line) // PAGE) * PAGE, b"\0")


def _check(path: Path, found: bytes, header: bytes, resume: bool) -> None:
    try:
        there, here = (json.loads(text.partition(b"\n")[0]) for text in (found, header))
        there["ensemble"]
        differences = [
            _difference(key, there.get(key), here.get(key))
            for key in here | there
            if there.get(key) != here.get(key)
        ]
    except (ValueError, TypeError, AttributeError, KeyError):
        raise FileError(
            f"{path}: is not an unfinished ensemble; choose another name or delete it"
        ) from None
    if not resume:
        raise FileError(
            f"{path}: an unfinished ensemble is there; continue it with --resume, or delete it to start anew"
        )
    if differences:
        raise InputError(
            f"{path}: holds another problem ({'; '.join(differences)}); delete it to start anew, or choose another name"
        )


def _difference(key: str, there: object, here: object) -> str:
    """The first lines in which two values differ."""
    lines = zip_longest(str(there).splitlines(), str(here).splitlines(), fillvalue="nothing")
    was, now = next((pair for pair in lines if pair[0] != pair[1]), (there, here))
    return f"{key}: {was!s:.60} there, {now!s:.60} here"


def _done(file: io.FileIO, start: int, layout: Layout) -> npt.NDArray[np.bool_]:
    checksums = _read(file, _checksums(start, layout), layout.blocks * NUMBER)
    done = np.zeros(layout.blocks, bool)
    for block in np.flatnonzero(np.frombuffer(checksums, "<u8")):
        runs = layout.within(int(block))
        offsets = (
            start + (column * layout.runs + runs.start) * NUMBER
            for column in range(len(layout.columns))
        )
        data = b"".join(
            _read(file, offset, (runs.stop - runs.start) * NUMBER) for offset in offsets
        )
        done[block] = (
            _checksum(int(block), data) == checksums[block * NUMBER : (block + 1) * NUMBER]
        )
    return done


def _checksums(start: int, layout: Layout) -> int:
    """Where the checksums begin."""
    return start + len(layout.columns) * layout.runs * NUMBER


def _checksum(block: int, data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=NUMBER, salt=block.to_bytes(16, "little")).digest()


def _lock(path: Path, file: io.FileIO) -> None:
    """Keep other processes out until the file is closed, where the system has locks."""
    if sys.platform == "win32":
        return
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        used = not os.fstat(
            file.fileno()
        ).st_nlink  # finished and removed by another process between opening and locking
    except BlockingIOError:
        used = True
    except OSError:  # some network file systems have no locks
        return
    if used:
        raise FileError(
            f"{path}: another process is writing it; wait for it, or choose another name"
        )


def _allocate(path: Path, file: io.FileIO, size: int, fresh: bool) -> None:
    """Take the disk space now, so that a disk too small is noticed before hours of work."""
    try:
        if fresh:
            file.truncate(0)
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            file.truncate(size)
    except BaseException:
        if fresh:
            path.unlink(missing_ok=True)
        raise


def _write(file: io.FileIO, offset: int, data: bytes) -> None:
    file.seek(offset)
    view = memoryview(data)
    while view:
        view = view[file.write(view) :]


def _read(file: io.FileIO, offset: int, size: int) -> bytes:
    file.seek(offset)
    return file.read(size)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, OverflowError, ValueError) as error:
        raise FileError(f"{path}: cannot write: {reason(error)}") from None
