"""Kernels compiled once per machine: each source in a file of its own, named by the hash of all that its machine code depends on."""

from __future__ import annotations

import functools
import hashlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from undeadzone.errors import FileError
from undeadzone.files import replacing


def folder() -> Path | None:
    """$UNDEADZONE_CACHE, or `undeadzone` in $XDG_CACHE_HOME or ~/.cache; None where there is no home."""
    if given := os.environ.get("UNDEADZONE_CACHE"):
        return Path(given)
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "undeadzone"
    except RuntimeError:
        return None


@functools.lru_cache(maxsize=64)
def load(source: str) -> Any:
    """The function `block` that the source defines, compiled now or taken from disk.

    The source asks numba to cache where `__file__` is defined. Where the folder cannot be used, or what it holds is
    damaged, the function is compiled in memory.
    """
    text = f"# {_machine()}\n{source}"
    path = _stored(text)
    if path is not None:
        try:
            return _execute(text, path)
        except Exception:  # whatever a damaged cache raises: compiling again tells it from a fault of the source
            _forget(path)
    return _execute(text, None)


def _machine() -> str:
    """What machine code depends on besides its source."""
    from importlib.metadata import version

    from llvmlite import binding

    versions = " ".join(f"{name} {version(name)}" for name in ("casadi", "numba", "llvmlite"))
    return f"{versions} {binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"


def _stored(text: str) -> Path | None:
    """The file of this text, written if need be; None if it cannot be."""
    if (kernels := folder()) is None:
        return None
    path = kernels / f"kernel_{hashlib.sha256(text.encode()).hexdigest()[:32]}.py"
    try:
        if not path.is_file():
            with replacing(path) as temporary:
                temporary.write_bytes(text.encode())
    except (OSError, FileError):
        return None
    return path


def _forget(path: Path) -> None:
    """Remove the compiled forms of a kernel."""
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*"):
        try:
            compiled.unlink()
        except OSError:
            return


def _execute(text: str, path: Path | None) -> Any:
    module = ModuleType("kernel" if path is None else path.stem)
    if path is not None:
        module.__file__ = str(path)
        sys.modules[module.__name__] = module  # numba looks it up by name when it reads compiled code back
    exec(compile(text, str(path or "<kernel>"), "exec"), module.__dict__)
    return module.block
