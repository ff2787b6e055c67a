"""Reading of plain files of limited size, and writing of files that are complete or absent."""

from __future__ import annotations

import difflib
import errno
import functools
import io
import os
import stat
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeAlias

from undeadzone.errors import FileError, InputError
from undeadzone.util.opening import open_descriptor, require_beneath

Name: TypeAlias = str | os.PathLike[str]  # of a file, as a program gives it
LARGEST_TEXT: Final = 10_000_000  # [bytes] of a scenario, a design, a URDF
LARGEST_TABLE: Final = 64_000_000  # [bytes] of a CSV file of signals
LARGEST_RUN: Final = 4_000_000_000  # [bytes] of the signals of one run
# Number of the meanings that keys have, in files and in JSON alike (docs/versions.md). It is raised
# when a key goes or changes its meaning; keys may be added.
SCHEMA: Final = 3
HIDDEN: Final = ".undeadzone-"  # what the name of a file begins with while it is written
NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def require_schema(schema: int | None, path: object) -> None:
    """Raise FileError for a saved result of another schema.

    Args:
        schema: of the file (None: it has no number, as files had none up to schema 2).
        path: of the file.
    """
    if schema != SCHEMA:
        raise FileError(
            f"{path}: expected schema = {SCHEMA}, found {schema}: another version of undeadzone "
            "saved it. Make it anew"
        )


@contextmanager
def convert_read_errors(
    path: Name, otherwise: str = "cannot read", cure: str = ""
) -> Iterator[None]:
    """Provide a block that reads a file, whose failures of any kind become FileError.

    Args:
        path: of the file, behind the key that names it.
        otherwise: what to say of a content that its decoders refuse.
        cure: sentence that follows.
    """
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise unreadable_file(path, error) from None
    except Exception as error:  # readers of zip archives and headers raise any kind
        is_text = isinstance(error, UnicodeDecodeError)
        why = "not UTF-8 text. Save it as UTF-8" if is_text else error
        raise FileError(f"{path}: {otherwise}: {why}{cure}") from None


@contextmanager
def convert_write_errors(path: Path) -> Iterator[None]:
    """Provide a block whose failures to write at a path become FileError."""
    try:
        yield
    except FileError:
        raise
    except (OSError, OverflowError, ValueError) as error:
        raise FileError(f"{path}: cannot write: {failure_reason(error)}") from None


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Provide a temporary path beside `path` that takes its name once written.

    Nothing is left half-written: what a killed process left is removed by the next one that writes
    in this folder. A link of that name is replaced, and not its target. A device or a pipe is not
    replaced.

    Raises:
        FileError: the file cannot be written.
    """
    with convert_write_errors(path):
        require_beneath(path)
        if path.exists():  # a device or a pipe is never replaced
            require_plain_file(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path.parent)
        handle, name = tempfile.mkstemp(path.suffix, f"{HIDDEN}{path.stem}-", path.parent)
        is_held = _hold(handle)
        if not is_held:
            os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, 0o666 & ~_process_umask())
        os.replace(name, path)
    except OSError as error:
        raise FileError(f"{path}: cannot write: {failure_reason(error)}") from None
    finally:
        Path(name).unlink(missing_ok=True)
        if is_held:
            os.close(handle)


@functools.cache
def _remove_leftovers(folder: Path) -> None:
    """Remove the files of a folder that killed processes were writing: nobody holds them."""
    for path in folder.glob(f"{HIDDEN}*"):
        with suppress(OSError), open_plain(path) as file:
            if _hold(file.fileno()):
                path.unlink()


def _hold(handle: int) -> bool | None:
    """Lock a file as long as it is open.

    Return whether this process has it, None if the system has no locks, as some network file
    systems.
    """
    if sys.platform == "win32":
        return None
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


@contextmanager
def open_scratch() -> Iterator[Path]:
    """Provide a temporary folder, removed at the end.

    Raises:
        FileError: the system refuses the folder, or room for a file.
    """
    made = False
    try:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
            made = True
            yield Path(name)
    except OSError as error:
        if made and error.errno not in NO_ROOM:
            raise
        raise FileError(
            f"temporary files: {failure_reason(error)}. Make room there, or set TMPDIR"
        ) from None


def to_path(name: Any) -> Path:
    """Return the path that a program names.

    Raises FileError for a value that is not a name, such as None.
    """
    if not isinstance(name, str | os.PathLike):
        found = type(name).__name__
        raise FileError(f"expected the name of a file, such as 'mine.toml', found {found}")
    return Path(name)


def read_bytes(path: Name, largest: int = LARGEST_TEXT) -> bytes:
    """Return the content of a user's file.

    Args:
        path: the file.
        largest: number of bytes that are read. A larger file is refused.

    Raises:
        OSError, ValueError: with the `reason`, also if it is not a plain file.
    """
    with open_plain(path, largest) as file:
        most = min(largest, os.fstat(file.fileno()).st_size + LARGEST_TEXT)  # size of the memory
        content = file.read(most + 1)
    if len(content) > most:  # it grows, or the system does not know its size
        raise OSError(_describe_excess_size(len(content), most))
    return content


@contextmanager
def open_plain(path: Name, largest: int | None = None) -> Iterator[BinaryIO]:
    """Provide a user's plain file, open for reading.

    Args:
        path: the file.
        largest: number of bytes that it may have (None: any).

    Raises:
        OSError, ValueError: with the `reason`, also if it is not a plain file.
    """
    _require_plain_status(os.stat(to_path(path)), largest)  # to open a device may do something
    with open(open_descriptor(path, os.O_RDONLY), "rb") as file:
        _require_plain_status(os.fstat(file.fileno()), largest)
        yield file


def read_table(module: str, name: str = "") -> dict[str, Any]:
    """Return the tables in a TOML file beside a module.

    Args:
        module: its `__file__`.
        name: of the file; "": that of the module.
    """
    beside = Path(module).with_suffix(".toml")
    return tomllib.loads((beside.parent / (name or beside.name)).read_text(encoding="utf-8"))


def read_text(path: Name, largest: int = LARGEST_TEXT) -> str:
    """Return the text of a user's UTF-8 file, without a byte-order mark.

    Arguments and errors as of `read_bytes`.
    """
    return read_bytes(path, largest).decode("utf-8-sig")


def require_plain_file(path: Name, largest: int | None = None) -> None:
    """Raise OSError unless the path is a plain file of an allowed size.

    A device would never end.

    Args:
        path: of the file, which is not opened.
        largest: number of bytes that it may have (None: any).
    """
    _require_plain_status(os.stat(to_path(path)), largest)


@contextmanager
def lock_file(path: Path, mode: str, largest: int | None = None) -> Iterator[io.FileIO]:
    """Provide the open, locked file in which a computation saves its results, created if missing.

    Nobody else may read it, and nothing is written through a link that someone put in its place. It
    is closed if the block inside fails, else it stays open.

    Args:
        path: of the file. Its folder is made too.
        mode: `r+` or `a+`.
        largest: number of bytes that it may have (None: any).

    Raises:
        FileError: it cannot be written, is not a plain file, has a second name, or is locked by
            another process.
    """
    with convert_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink():
            raise OSError(_describe_alias("it is a symbolic link"))
        if path.exists():
            require_plain_file(path, largest)
        file = io.FileIO(path, mode, opener=_open_or_create)
    try:
        with convert_write_errors(path):
            status = os.fstat(file.fileno())
            _require_plain_status(status, largest)
            if status.st_nlink > 1:
                raise OSError(_describe_alias(f"it is one of {status.st_nlink} names of a file"))
        _lock_exclusively(path, file)
        yield file
    except BaseException:
        file.close()
        raise


def _open_or_create(name: str, flags: int) -> int:
    """Open a file, or create a missing one. The content stays, links are not followed."""
    return open_descriptor(name, flags | getattr(os, "O_NOFOLLOW", 0) | os.O_CREAT)


def _lock_exclusively(path: Path, file: io.FileIO) -> None:
    """Lock a file against further processes until it is closed, if the system has locks.

    Raises:
        FileError: another process has it.
    """
    is_held = _hold(file.fileno())
    # Another process may have finished and removed it between opening and locking.
    if is_held is False or (is_held and not os.fstat(file.fileno()).st_nlink):
        raise FileError(
            f"{path}: another process is writing it. Wait for it, or choose another name"
        )


def write_all_bytes(path: Path, file: io.FileIO, data: bytes, offset: int | None = None) -> None:
    """Write all bytes, in as many calls as the system needs.

    Args:
        path: of the file.
        file: which is open.
        data: to be written.
        offset: place in the file (None: its present position, or its end if it is open for
            appending).

    Raises:
        FileError: disk full, or the file was removed.
    """
    if not os.fstat(file.fileno()).st_nlink:
        raise FileError(f"{path}: cannot write: it was removed")
    with convert_write_errors(path):
        if offset is not None:
            file.seek(offset)
        view = memoryview(data)
        while view:
            view = view[file.write(view) :]


def _describe_alias(found: str) -> str:
    """Return the reason to refuse a file that has further names."""
    return f"{found}, and its target would be overwritten. Delete it, or choose another name"


def load_arrays(path: Path, largest: int) -> dict[str, Any]:
    """Return the arrays of an `.npz`, by name.

    Args:
        path: of the file.
        largest: number of bytes that it may have, and unpack to.

    Raises:
        OSError: with the `reason`, also if it is not a plain file.
        Exception: of any kind, it is damaged, or something else.
    """
    import numpy as np

    with open_plain(path, largest) as opened:
        require_small_archive(opened, largest)
        with np.load(opened, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}


def require_small_archive(file: BinaryIO, largest: int) -> None:
    """Raise ValueError if an open zip archive would unpack to more than a number of bytes."""
    with zipfile.ZipFile(file) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > largest:
        raise ValueError(f"it would unpack to {size / 1e6:,.0f} MB")
    file.seek(0)


def _require_plain_status(status: os.stat_result, largest: int | None) -> None:
    """Raise OSError unless the status is that of a plain file of an allowed size."""
    if stat.S_ISDIR(status.st_mode):
        raise OSError("it is a directory")
    if not stat.S_ISREG(status.st_mode):
        raise OSError("it is a device, a pipe or a socket, no plain file")
    if largest is not None and status.st_size > largest:
        raise OSError(_describe_excess_size(status.st_size, largest))


def _describe_excess_size(size: int, largest: int) -> str:
    """Return the reason to refuse a file that is too large."""
    return f"it has {size / 1e6:,.0f} MB, and files of this kind may have {largest / 1e6:,.0f}"


def require_folder(folder: Path) -> None:
    """Raise FileError unless files can be written in a folder. The test leaves no file behind.

    Called before a long computation, whose results would be lost otherwise. The folder itself is
    not made for it: another process might count on it, or fail to make its own.

    Args:
        folder: it need not exist. Then it must be possible to make it.
    """
    with convert_write_errors(folder):
        there = next(place for place in (folder, *folder.parents) if os.path.lexists(place))
        with tempfile.TemporaryDirectory(dir=there, prefix=".undeadzone-") as attempt:
            Path(attempt, folder.relative_to(there)).mkdir(parents=True, exist_ok=True)


def write_text(text: str, path: Name) -> Path:
    """Write a text file in UTF-8, complete or not at all. Return its path.

    Raises:
        FileError: it cannot be written.
    """
    target = to_path(path)
    with replace_file(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return target


def unreadable_file(path: Name, error: Exception) -> FileError:
    """Return the error of a file that cannot be read, with the reason and the nearest name."""
    folder, name = os.path.split(path)
    missing = isinstance(error, FileNotFoundError) and os.path.isdir(folder or ".")
    near = difflib.get_close_matches(name, os.listdir(folder or "."), 1) if missing else []
    meant = "".join(f". Did you mean {os.path.join(folder, each)!r}?" for each in near)
    return FileError(f"{path}: cannot read: {failure_reason(error)}{meant}")


def failure_reason(error: Exception) -> str:
    """Return the reason that a file could not be read or written, without its path.

    It is the system's message, if there is one.
    """
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    return str(error)


def _process_umask() -> int:
    """Return the permissions that the system withholds from new files."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
