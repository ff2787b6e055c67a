"""Files that are either complete or absent."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from undeadzone.errors import FileError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its name once written.

    Nothing is left half-written.

    Raises:
        FileError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix
        )
        os.close(handle)
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot write: {reason(error)}") from None
    try:
        yield Path(name)
        os.chmod(name, 0o666 & ~_umask())
        os.replace(name, path)
    except OSError as error:
        raise FileError(f"{path}: cannot write: {reason(error)}") from None
    finally:
        Path(name).unlink(missing_ok=True)


def write_text(text: str, path: Path) -> Path:
    """Write a text file in UTF-8; nothing is left half-written.

    Raises:
        FileError: it cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def reason(error: Exception) -> str:
    """Why a file could not be read or written, without its path.

    In the system's words where there are any.
    """
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    return str(error)


def _umask() -> int:
    """The permissions that the system withholds from new files."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
