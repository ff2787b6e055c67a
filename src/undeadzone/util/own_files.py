"""Protection of edited files: a command replaces only texts and folders as undeadzone wrote them.

A text of its own holds a remark with a digest of all the rest. A folder of its own has a
manifest that holds a digest of every file. All else is the user's: it stays, unless `force` is set.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from undeadzone.errors import FileError
from undeadzone.util.files import LARGEST_RUN, convert_write_errors, read_bytes, write_text

CURE: Final = "choose another name or out=NAME, or replace it with force=True"
REMARK: Final = "undeadzone wrote this file, and replaces it until someone edits it: "
_SIGNED: Final = re.compile(re.escape(REMARK) + "([0-9a-f]{64})")


def mark_toml(text: str) -> str:
    """Return a TOML text under a signed remark that undeadzone wrote the file.

    Args:
        text: of the file.
    """
    return sign_text(f"# {REMARK}\n{text}")


def sign_text(text: str) -> str:
    """Return a text with its digest behind the remark REMARK in it.

    Args:
        text: of the file.
    """
    before, after = text.split(REMARK, 1)
    return f"{before}{REMARK}{content_digest(text.encode())}{after}"


def require_own_file(
    path: Path, force: bool = False, is_own: Callable[[Path], bool] | None = None
) -> None:
    """Raise FileError for a file that was edited since undeadzone wrote it (`sign_text`).

    Called before a long computation, whose result would be lost otherwise.

    Args:
        path: of the file, which need not exist.
        force: whether it may be replaced all the same.
        is_own: predicate of a file that undeadzone wrote (None: by its digest).
    """
    known = is_own or is_own_file
    with convert_write_errors(path):  # a name that is too long
        exists = path.exists() or path.is_symlink()
    if exists and not force and not known(path):
        raise FileError(
            f"{path}: exists already, and may hold work of your own: not replaced; {CURE}"
        )


def write_own_file(text: str, path: Path, force: bool = False) -> Path:
    """Write a text that undeadzone may replace later.

    Raises FileError, also as `require_own_file`.

    Args:
        text: of the file, TOML.
        path: of the file.
        force: whether a file of someone else is replaced.
    """
    require_own_file(path, force)
    return write_text(mark_toml(text), path)


def list_edited_files(folder: Path, digests: Mapping[str, str]) -> list[str]:
    """Return the files in a folder that were edited since undeadzone wrote them.

    Missing files do not count.

    Args:
        folder: of the files.
        digests: of each as it was written, by its path there.
    """
    return [path for path in digests if not _is_unedited(folder / path, digests[path])]


def content_digest(content: bytes) -> str:
    """Return the SHA-256 digest of the content of a file, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def is_own_file(path: Path) -> bool:
    """Return whether a text is as undeadzone wrote it. Line ends do not count."""
    try:
        text = read_bytes(path).decode().replace("\r\n", "\n")
    except (OSError, ValueError):
        return False
    found = _SIGNED.search(text)
    return found is not None and sign_text(text.replace(found[1], "", 1)) == text


def _is_unedited(path: Path, written: str) -> bool:
    """Return whether a file has a digest, or is missing."""
    try:
        return content_digest(read_bytes(path, LARGEST_RUN)) == written
    except FileNotFoundError:
        return True
    except OSError:
        return False
