"""Restriction of this process for untrusted files: limits on reading, writing and resources."""

from __future__ import annotations

import atexit
import ctypes
import os
import shutil
import signal
import struct
import sys
import tempfile
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from types import FrameType
from typing import Final

from undeadzone.errors import Terminated
from undeadzone.util.files import require_folder
from undeadzone.util.opening import open_descriptor

MEMORY: Final = 4_000_000_000  # [bytes] of addresses
FILE: Final = 500_000_000  # [bytes] of one file
CPU_TIME: Final = 600  # [s]
SYSTEM: Final = (
    "/usr", "/lib", "/lib64", "/bin", "/etc", "/opt", "/proc", "/sys/devices/system/cpu",
    "/dev/urandom",
)  # fmt: skip

# Linux's Landlock: numbers of its calls and rights, from the kernel's headers.
CREATE = 444
ADD = 445
RESTRICT = 446
NO_NEW_PRIVILEGES = 38
VERSION = 1
BENEATH = 1
EXECUTE = 1
WRITE_FILE = 2
READ_FILE = 4
READ_FOLDER = 8
OF_FILES: Final = EXECUTE | WRITE_FILE | READ_FILE
EVERY: Final = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1}  # rights by version
TRUNCATE: Final = 1 << 14


def restrict_process(folder: Path, out: Path | None, ending: ExitStack) -> list[str]:
    """Restrict this process to read strangers' files from `folder` and to write below `out`.

    No module comes from `folder`. Memory and CPU time are limited, unless less is allowed already.
    If the kernel has Landlock, nothing else can be read but the files that programs and libraries
    need, and nothing else written. All of this lasts, and holds for every process started from
    here.

    Args:
        folder: of the strangers.
        out: created if missing (None: nothing is written).
        ending: of the command, which takes temporary files along.

    Returns:
        What this system cannot hold, in words.

    Raises:
        FileError: nothing can be written below `out`.
    """
    here = Path(os.path.realpath(folder))
    sys.path[:] = [
        place for place in sys.path if place and not _is_untrusted_place(Path(place), here)
    ]
    if out is not None:
        require_folder(out)
        out.mkdir(parents=True, exist_ok=True)
        _use_scratch_folder(out, ending)
    written = [place for place in (out, _kernel_cache_folder()) if place is not None]
    lacking = []
    if not _limit_resources():
        lacking.append("no limits of memory and time on this system")
    if not _restrict_files([here, *_library_places()], written):
        lacking.append("no Landlock on this system: paths are checked, nothing more")
    return lacking


def _is_untrusted_place(place: Path, folder: Path) -> bool:
    """Return whether a place of modules is in `folder`, or the start folder of `python -m`."""
    own = Path(__file__).parents[2]
    real = Path(os.path.realpath(place))
    return real.is_relative_to(folder) or (real == Path.cwd() and real != own)


def _use_scratch_folder(out: Path, ending: ExitStack) -> None:
    """Put temporary files below `out`. They are deleted when the command ends."""
    scratch = tempfile.mkdtemp(dir=out.absolute(), prefix=".scratch-")
    # Matplotlib deletes its own folder at the interpreter's end, and this call comes after that.
    atexit.register(shutil.rmtree, scratch, ignore_errors=True)
    ending.callback(_empty_scratch_folder, Path(scratch))
    tempfile.tempdir = os.environ["TMPDIR"] = scratch


def _empty_scratch_folder(scratch: Path) -> None:
    """Delete the temporary files of a command, except a folder that Matplotlib deletes itself."""
    for path in scratch.iterdir():
        if path.is_file():
            path.unlink(missing_ok=True)
        elif not path.name.startswith("matplotlib-"):
            shutil.rmtree(path, ignore_errors=True)
    with suppress(OSError):  # Matplotlib's folder is there: the end of the interpreter follows
        scratch.rmdir()


def _kernel_cache_folder() -> Path | None:
    """Return the folder of cached kernels, created if missing, or None on failure."""
    from undeadzone.compile.cache_folder import cache_directory

    place = cache_directory()
    try:
        if place is not None:
            place.mkdir(parents=True, exist_ok=True, mode=0o700)
    except OSError:
        return None
    return place


def _library_places() -> list[Path]:
    """Return the places that programs and libraries need to read."""
    package = Path(__file__).parents[2]
    places = [*map(Path, (*SYSTEM, sys.prefix, sys.base_prefix, *sys.path)), package]
    return [place for place in places if place.exists()]


def _limit_resources() -> bool:
    """Limit memory, CPU time and core files. Return whether the system can."""
    if sys.platform == "win32":
        return False
    import resource

    for kind, most in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_CPU, CPU_TIME),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, FILE),
    ):
        allowed, hard = resource.getrlimit(kind)
        if allowed == resource.RLIM_INFINITY or allowed > most:
            resource.setrlimit(kind, (most, hard))
    signal.signal(signal.SIGXCPU, _raise_out_of_time)
    return True


def _raise_out_of_time(number: int, frame: FrameType | None) -> None:
    """Raise Terminated: CPU time ran out."""
    raise Terminated(f"{CPU_TIME} s of CPU time ran out, which --untrusted allows")


def _restrict_files(read: Iterable[Path], written: Iterable[Path]) -> bool:
    """Remove all further rights on files. Return whether the kernel can."""
    if sys.platform != "linux":
        return False
    kernel = ctypes.CDLL(None, use_errno=True)
    version = kernel.syscall(CREATE, None, ctypes.c_size_t(0), VERSION)
    if version < 1:
        return False
    every = EVERY[min(version, max(EVERY))]
    # The rights that are removed unless a rule grants them.
    ruleset_attr = struct.pack("=Q", every)
    rules = kernel.syscall(CREATE, ruleset_attr, ctypes.c_size_t(len(ruleset_attr)), 0)
    if rules < 0:
        return False
    try:
        for place in read:
            _grant_rights(kernel, rules, place, EXECUTE | READ_FILE | READ_FOLDER)
        for place in (*written, Path(os.devnull)):
            _grant_rights(kernel, rules, place, every)
        kernel.prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
        return bool(kernel.syscall(RESTRICT, rules, 0) == 0)
    finally:
        os.close(rules)


def _grant_rights(kernel: ctypes.CDLL, rules: int, place: Path, rights: int) -> None:
    """Grant rights below a folder, or the rights of a file on a file."""
    if not place.is_dir():
        rights &= OF_FILES | TRUNCATE
    descriptor = open_descriptor(place, os.O_PATH)
    try:
        kernel.syscall(ADD, rules, BENEATH, struct.pack("=Qi", rights, descriptor), 0)
    finally:
        os.close(descriptor)
