"""C compiler of the host."""

from __future__ import annotations

import functools
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from undeadzone.errors import InputError
from undeadzone.util.files import failure_reason, open_scratch

FLAGS = ("-std=c99", "-ffp-contract=off", "-fno-math-errno")
SMALL = ("-Os", "-ffunction-sections", "-c")
NAMES = ("cc", "gcc", "clang")


def find_compiler() -> str | None:
    """Return the command of a C compiler: $CC, else cc, gcc or clang.

    Return None if none is found.
    """
    for name in (os.environ.get("CC", ""), *NAMES):
        if name and shutil.which(name):
            return name
    return None


def require_compiler() -> str:
    """Return the command of a C compiler. Raises InputError if none is found."""
    command = find_compiler()
    if command is None:
        raise InputError("no C compiler: expected cc, gcc or clang in PATH, or the variable CC")
    return command


def write_sources(files: dict[str, str], folder: Path) -> list[str]:
    """Write files into a folder and return the paths of the C files.

    Args:
        files: texts by name.
        folder: folder of the files.
    """
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [str(folder / name) for name in files if name.endswith(".c")]


def compile_library(sources: list[str], out: Path, options: tuple[str, ...] = ("-O1",)) -> Path:
    """Compile C into a shared library.

    Args:
        sources: the files, all in one folder.
        out: the library to be made.
        options: for the compiler, beside those that keep the bits.

    Raises:
        InputError: there is no compiler, or it refuses.
    """
    command = require_compiler()
    every = [*FLAGS, *options, "-fPIC", "-shared", "-o", str(out.absolute())]
    for extra in (["-fstack-usage"], []):  # a compiler that does not know the first gets none
        line = [command, *extra, *every, *sources, "-lm"]
        finish = _run_compiler(line, out.parent)
        if finish.returncode == 0:
            break
    if finish.returncode or not out.exists():
        why = finish.stderr.strip()[:500] or "nothing is compiled"
        raise InputError(f"{command} refuses the exported code: {why}")
    return out


def _run_compiler(line: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a compiler in a folder. Raises InputError if it cannot be run.

    Whatever stops this process ends the compiler with all processes that it has started, and takes
    its temporary files along.
    """
    with open_scratch() as scratch:
        try:
            process = subprocess.Popen(
                line,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                cwd=folder,
                env=os.environ | {"TMPDIR": str(scratch)},
                start_new_session=sys.platform != "win32",
            )
        except OSError as error:
            raise InputError(
                f"{line[0]}: the C compiler cannot be run: {failure_reason(error)}"
            ) from None
        with process:
            try:
                out, errors = process.communicate()
            except BaseException:
                if sys.platform == "win32":
                    process.kill()
                else:
                    os.killpg(process.pid, signal.SIGKILL)
                raise
    return subprocess.CompletedProcess(line, process.returncode, out, errors)


@functools.lru_cache(1)
def object_bytes(command: str, files: tuple[tuple[str, str], ...]) -> int | None:
    """Return the flash of compiled C, code with constants [bytes]. None without that compiler.

    Args:
        command: a gcc for another processor, with its options.
        files: name and text of each file of the C.
    """
    name, *options = command.split()
    if shutil.which(name) is None:
        return None
    with open_scratch() as folder:
        sources = write_sources(dict(files), folder)
        _run_compiler([name, *options, *FLAGS, *SMALL, "-o", "flash.o", *sources], folder)
        listed = _run_compiler([name.removesuffix("gcc") + "size", "flash.o"], folder).stdout
    sizes = re.findall(r"\d+", listed)
    return int(sizes[0]) + int(sizes[1]) if sizes else None


def stack_bytes(folder: Path, prefix: str) -> int | None:
    """Return the stack of a step as the compiler reports it [bytes], or None.

    It is the largest sum of the frames of functions that call each other.

    Args:
        folder: where `compile_library` put its output, with the sources.
        prefix: first part of the names of the functions.
    """
    frames: dict[str, int] = {}
    for path in folder.glob("*.su"):
        for line in path.read_text(encoding="utf-8").splitlines():
            place, size, _ = line.split("\t")
            frames[place.rsplit(":", 1)[-1].split(".")[0]] = int(size)
    calls: dict[str, set[str]] = {}
    for path in folder.glob(f"{prefix}*.[ch]"):
        for text in path.read_text(encoding="utf-8").split("\n}\n"):
            head, _, body = text.rpartition("\n{\n")
            name = re.findall(r"\b(\w+)\(", head)[-1:]
            calls |= {key: set(re.findall(r"\b(\w+)\(", body)) for key in name}

    def deepest(name: str) -> int:
        """Return the stack of a function and of those that it calls."""
        below = list(map(deepest, calls[name] & calls.keys()))
        return frames.get(name, 0) + max(below, default=0)

    steps = [f"{prefix}_{name}" for name in ("step", "estimate", "advance")]
    return max(map(deepest, calls.keys() & steps)) if frames.keys() & steps else None


def run_selftest(files: dict[str, str]) -> tuple[bool, str]:
    """Build and run the self-test of an export, and return whether it passed and its output.

    Args:
        files: the C of the export and of its self-test, by name.

    Raises:
        InputError: there is no compiler.
    """
    command = require_compiler()
    with open_scratch() as folder:
        make = [command, *FLAGS, "-O2", "-o", "tested", *write_sources(files, folder), "-lm"]
        built = _run_compiler(make, folder)
        if built.returncode:
            return False, built.stderr.strip()[:500]
        done = subprocess.run([folder / "tested"], capture_output=True, text=True)
    return done.returncode == 0, done.stdout.strip()
