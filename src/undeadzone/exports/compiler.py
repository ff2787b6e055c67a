"""The host's C compiler, where there is one."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from undeadzone.errors import InputError

FLAGS = ("-std=c99", "-ffp-contract=off", "-fno-math-errno")
NAMES = ("cc", "gcc", "clang")


def compiler() -> str | None:
    """The command of a C compiler: $CC, else cc, gcc or clang; None where there is none."""
    for name in (os.environ.get("CC", ""), *NAMES):
        if name and shutil.which(name):
            return name
    return None


def shared_library(sources: list[Path], out: Path) -> Path:
    """Compile C into a shared library.

    Args:
        sources: the files.
        out: the library to be made.

    Raises:
        InputError: there is no compiler, or it refuses.
    """
    command = compiler()
    if command is None:
        raise InputError("no C compiler: expected cc, gcc or clang in PATH, or the variable CC")
    files = [str(path) for path in sources]
    options = [*FLAGS, "-O1", "-fPIC", "-shared", "-o", str(out)]
    finish = subprocess.run([command, *options, *files, "-lm"], capture_output=True, text=True)
    if finish.returncode:
        raise InputError(f"{command} refuses the exported code: {finish.stderr.strip()[:500]}")
    return out


def self_tested(folder: Path, name: str) -> tuple[bool, str]:
    """(whether it passed, what it printed) of `make` and the self-test of an export.

    Args:
        folder: the export; it is left as it was but for the program, which is removed.
        name: its prefix.
    """
    command = compiler()
    if command is None:
        return False, "no C compiler: expected cc, gcc or clang in PATH, or the variable CC"
    program = folder / f"{name}_test"
    sources = [str(folder / f"{name}.c"), str(folder / f"{name}_test.c")]
    make = [command, *FLAGS, "-O2", "-o", str(program), *sources, "-lm"]
    try:
        built = subprocess.run(make, capture_output=True, text=True)
        if built.returncode:
            return False, built.stderr.strip()[:500]
        done = subprocess.run([str(program)], capture_output=True, text=True)
    finally:
        program.unlink(missing_ok=True)
    return done.returncode == 0, done.stdout.strip()
