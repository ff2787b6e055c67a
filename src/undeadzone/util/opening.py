"""Opening of the files that users and scenarios name: below a stranger's folder nothing leads out.

Once a process is bound to a folder, a file there is opened by the kernel itself beneath it
(`openat2`, Linux 5.6), so a link that someone exchanges meanwhile leads nowhere. Elsewhere the path
is looked at first.
"""

from __future__ import annotations

import ctypes
import errno
import os
import stat
import struct
import sys
from pathlib import Path
from typing import Any, Final, NamedTuple

OPENAT2: Final = 437  # number of the call on every processor
BENEATH: Final = 0x08 | 0x04 | 0x02  # RESOLVE_BENEATH, _NO_SYMLINKS, _NO_MAGICLINKS
ATTEMPTS: Final = 8  # while someone renames folders on the way
PATH_ALONE: Final = getattr(os, "O_PATH", 0)  # opens nothing but the place


class Bound(NamedTuple):
    """Folder that no file below it leads out of.

    Attributes:
        named: as the user names it.
        real: links followed.
        descriptor: of the open folder (None on a system without `openat2`).
    """

    named: Path
    real: Path
    descriptor: int | None

    def contains_path(self, path: Path) -> bool:
        """Return whether a path begins in this folder, or its target does."""
        named = Path(os.path.abspath(self.named))
        places = Path(os.path.abspath(path)), Path(os.path.realpath(path))
        return any(each.is_relative_to(named) or each.is_relative_to(self.real) for each in places)


_BOUNDS: list[Bound] = []


def bind_folder(folder: Path) -> None:
    """Bind this process for good: no path that begins in `folder` is opened that leads out of it.

    Args:
        folder: that strangers made.
    """
    real = Path(os.path.realpath(folder))
    descriptor = None
    if sys.platform == "linux":
        descriptor = os.open(real, PATH_ALONE | os.O_DIRECTORY | os.O_CLOEXEC)
    _BOUNDS.append(Bound(folder, real, descriptor))


def open_descriptor(path: str | os.PathLike[str], flags: int) -> int:
    """Open a file or folder that a user or a scenario names, and return its descriptor.

    Args:
        path: of it.
        flags: of `os.open`. A call that would wait for the other end of a pipe does not.

    Raises:
        OSError: with the reason, also for what leads out of a folder that binds this process.
    """
    flags |= getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    if not flags & PATH_ALONE:  # a pipe may have taken a file's place
        flags |= getattr(os, "O_NONBLOCK", 0)
    bound = next((each for each in _BOUNDS if each.contains_path(Path(path))), None)
    if bound is None:
        return os.open(path, flags, 0o600)
    descriptor = _open_beneath(bound, _resolve(bound, Path(path), flags), flags, 0o600)
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and status.st_nlink > 1:
        os.close(descriptor)
        raise OSError("hard links show this file elsewhere too. Copy it into the untrusted folder")
    return descriptor


def require_beneath(path: Path) -> None:
    """Raise OSError for a path that begins in a folder that binds this process, and leads out.

    Args:
        path: of the file to be written. It need not exist.
    """
    for bound in _BOUNDS:
        if bound.contains_path(path):
            _resolve(bound, path, 0)


def _resolve(bound: Bound, path: Path, flags: int) -> Path:
    """Return the real path of a file, relative to the folder. Raises OSError if it is outside."""
    follows = not flags & getattr(os, "O_NOFOLLOW", 0)
    real = Path(os.path.realpath(path if follows else path.parent))
    real = real if follows else real / path.name
    if not real.is_relative_to(bound.real):
        raise OSError(f"a link that leads out of the untrusted folder {bound.named}")
    return real.relative_to(bound.real)


def _open_beneath(bound: Bound, relative: Path, flags: int, mode: int) -> int:
    """Open a file beneath a folder without following any link, and return its descriptor."""
    if bound.descriptor is not None:
        kernel: Any = ctypes.CDLL(None, use_errno=True)
        creates = flags & os.O_CREAT
        how = struct.pack("=QQQ", flags, mode if creates else 0, BENEATH)
        name = os.fsencode(relative)
        for _ in range(ATTEMPTS):
            found = kernel.syscall(OPENAT2, bound.descriptor, name, how, ctypes.c_size_t(len(how)))
            if found >= 0:
                return int(found)
            reason = ctypes.get_errno()
            if reason != errno.EAGAIN:
                break
        if reason not in (errno.ENOSYS, errno.EPERM):  # none, or none for this process
            raise OSError(reason, os.strerror(reason), str(bound.named / relative))
    return os.open(bound.real / relative, flags | getattr(os, "O_NOFOLLOW", 0), mode)
