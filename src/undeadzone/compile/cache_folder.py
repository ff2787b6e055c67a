"""Folder of compiled kernels: writable by this user only, and limited in age and size.

A kernel is machine code, so reading one back means running what its file holds. A file is read only
if the folder and the file belong to this user and nobody else may write them. Otherwise there is no
cache: kernels are compiled, and none is kept.
"""

from __future__ import annotations

import os
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NamedTuple

SUFFIX: Final = ".kernel"
UNUSED: Final = 90 * 86400.0  # [s] after which a kernel that nobody used is deleted
LARGEST: Final = 10**9  # [bytes] of all kernels
WRITABLE_BY_OTHERS: Final = stat.S_IWGRP | stat.S_IWOTH


class Entry(NamedTuple):
    """Kernel in the folder.

    Attributes:
        used: when it was written or read last [s since 1970].
        size: [bytes].
        name: of its file.
    """

    used: float
    size: int
    name: str


def cache_directory() -> Path | None:
    """Return the folder of the kernels, or None if no absolute path is known.

    $UNDEADZONE_CACHE, or `undeadzone` in $XDG_CACHE_HOME or ~/.cache. Relative paths are ignored:
    they would take code from whatever folder a command is started in.
    """
    own, shared = (os.environ.get(name, "") for name in ("UNDEADZONE_CACHE", "XDG_CACHE_HOME"))
    home = os.path.expanduser("~")
    for folder, below in ((own, ""), (shared, "undeadzone"), (home, ".cache/undeadzone")):
        if os.path.isabs(folder):
            return Path(folder, below)
    return None


def read_kernel_file(folder: Path, name: str) -> bytes | None:
    """Return the content of a file of the folder, or None if it is missing or writable by
    other users.
    """
    try:
        with _open_folder(folder) as directory:
            return _read_file(directory, name)
    except OSError:
        return None


def write_kernel_file(folder: Path, name: str, content: bytes) -> None:
    """Write a file of the folder if possible, and delete old and excess files."""
    try:
        _make(folder)
        with _open_folder(folder) as directory:
            _write(directory, name, content)
            trim_folder(directory, name)
    except OSError:
        pass


def trim_folder(directory: Path | int, newest: str) -> None:
    """Delete kernels unused for long, then the least recently used until the total size is
    allowed.

    Args:
        directory: the folder, or its descriptor.
        newest: the file that stays in any case.
    """
    entries = [entry for entry in _list_kernels(directory) if entry.name != newest]
    oldest = time.time() - UNUSED
    excess = sum(entry.size for entry in entries) - LARGEST
    for entry in sorted(entries):
        if entry.used >= oldest and excess <= 0:
            return
        with suppress(OSError):  # another process may have deleted it
            _unlink(directory, entry.name)
        excess -= entry.size


def _list_kernels(directory: Path | int) -> list[Entry]:
    """Return the kernels of a folder, including temporary files of writers that died."""
    entries = []
    with os.scandir(directory) as files:
        for file in files:
            if not file.name.endswith(SUFFIX):
                continue
            with suppress(OSError):
                status = file.stat(follow_symlinks=False)
                entries.append(Entry(status.st_mtime, status.st_size, file.name))
    return entries


if sys.platform == "win32":
    # Windows has neither owners and modes of this kind nor descriptors of folders. There the cache
    # lies in the user's profile, whose access list keeps other users out; nothing is checked.

    @contextmanager
    def _open_folder(folder: Path) -> Iterator[Path]:
        """Provide the folder."""
        yield folder

    def _make(folder: Path) -> None:
        """Create the folder."""
        folder.mkdir(parents=True, exist_ok=True)

    def _read_file(directory: Path, name: str) -> bytes:
        """Return the content of a file and set the file's time to now."""
        content = (directory / name).read_bytes()
        with suppress(OSError):
            os.utime(directory / name)
        return content

    def _write(directory: Path, name: str, content: bytes) -> None:
        """Write a file. The file is whole or absent."""
        handle, temporary = tempfile.mkstemp(dir=directory, prefix=".", suffix=SUFFIX)
        try:
            with open(handle, "wb") as file:
                file.write(content)
            os.replace(temporary, directory / name)
        finally:
            Path(temporary).unlink(missing_ok=True)

    def _unlink(directory: Path | int, name: str) -> None:
        """Delete a file."""
        assert isinstance(directory, Path)
        (directory / name).unlink()

else:
    # Everything goes through the descriptor of the folder that was checked: nobody can put another
    # folder or a link in its place between the check and the use.

    @contextmanager
    def _open_folder(folder: Path) -> Iterator[int]:
        """Yield the folder."""
        directory = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            _require_own(os.fstat(directory))
            yield directory
        finally:
            os.close(directory)

    def _require_own(status: os.stat_result) -> None:
        """Raise PermissionError unless this user owns the file and nobody else can write
        to it.
        """
        if status.st_uid != os.geteuid() or status.st_mode & WRITABLE_BY_OTHERS:
            raise PermissionError

    def _make(folder: Path) -> None:
        """Make the folder for this user alone. An existing one of this user is closed to
        readers.
        """
        folder.parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError):
            os.mkdir(folder, 0o700)
        with _open_folder(folder) as directory:
            if os.fstat(directory).st_mode & 0o077:
                os.fchmod(directory, 0o700)

    def _read_file(directory: int, name: str) -> bytes:
        """Return the content of a file and set its time to now."""
        # Not blocking: a named pipe must not keep the command waiting.
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK
        with open(os.open(name, flags, dir_fd=directory), "rb") as file:
            status = os.fstat(file.fileno())
            _require_own(status)
            # A second hard link could lead to a file that is not of this cache.
            if not stat.S_ISREG(status.st_mode) or status.st_nlink != 1:
                raise PermissionError
            with suppress(OSError):  # the time of use decides which files are deleted first
                os.utime(file.fileno())
            return file.read()

    def _write(directory: int, name: str, content: bytes) -> None:
        """Write a file that this user alone may read. It is whole or absent."""
        temporary = f".{os.urandom(8).hex()}{SUFFIX}"
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
        try:
            with open(os.open(temporary, flags, 0o600, dir_fd=directory), "wb") as file:
                os.fchmod(file.fileno(), 0o600)
                file.write(content)
            os.replace(temporary, name, src_dir_fd=directory, dst_dir_fd=directory)
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary, dir_fd=directory)
            raise

    def _unlink(directory: Path | int, name: str) -> None:
        """Delete a file."""
        assert isinstance(directory, int)
        os.unlink(name, dir_fd=directory)
