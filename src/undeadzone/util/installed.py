"""Installed packages: their versions, entry points by group and name, and a lean SciPy."""

from __future__ import annotations

import functools
import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

from undeadzone.errors import DamagedPackage, InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

PACKAGES = ("casadi", "llvmlite", "numpy", "scipy")  # they decide the last bits of results
ARENA = "undeadzone_arena has the methods of the literature: pip install undeadzone_arena"


def package_versions() -> dict[str, str]:
    """Return the versions of this package and of the packages that decide the last bits of its
    results.
    """
    import undeadzone

    return {
        "undeadzone": undeadzone.__version__,
        **{name: _version_of_package(name) for name in PACKAGES},
    }


def _version_of_package(name: str) -> str:
    """Return the version of an installed package."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def list_registered_places(group: str) -> dict[str, str]:
    """Return where registered objects are, `module:name`, by name. They are read anew after an
    installation.

    Args:
        group: of the entry points.
    """
    folders = filter(os.path.isdir, map(os.path.abspath, sys.path))
    return _find_entry_points(
        group, tuple((folder, os.stat(folder).st_mtime_ns) for folder in folders)
    )


@functools.lru_cache
def _find_entry_points(group: str, searched: tuple[tuple[str, int], ...]) -> dict[str, str]:
    """Return the `module:Class` of a group by method, sorted: the order of packages is a folder's.
    They are cached while the searched folders are unchanged.
    """
    from importlib.metadata import entry_points

    try:
        points = [*entry_points(group=group)]
    except Exception:  # any error of the reader of one damaged file
        points = [*_readable_entry_points(group)]
    return {point.name: point.value for point in sorted(points)}


def _readable_entry_points(group: str) -> Iterator[EntryPoint]:
    """Yield the entry points of packages whose files can be read, and warn of each other one."""
    from importlib.metadata import distributions

    for package in distributions():
        try:
            yield from package.entry_points.select(group=group)
        except Exception:
            name = getattr(package, "name", None) or "a package"
            words = f"{name}: its entry points cannot be read. It is left out"
            warnings.warn(words, DamagedPackage, stacklevel=2)


def advise_on_arena() -> str:
    """Name the package of the methods of the literature, unless it is installed."""
    return "" if "arena" in list_registered_places("undeadzone.commands") else f". {ARENA}"


def load_object(what: str, place: str) -> Any:
    """Return the object that a package registers.

    Args:
        what: is registered, for messages.
        place: `module:name`.

    Raises:
        InputError: it cannot be imported.
    """
    module, _, name = place.partition(":")
    try:
        return getattr(import_module(module), name)
    except (Exception, SystemExit) as error:
        raise InputError(f"{what} is registered at {place}, which fails: {error}") from None


def load_registered(group: str, name: str) -> Any:
    """Return the object that a package registers under a name.

    Args:
        group: of the entry points.
        name: in the group.

    Raises:
        InputError: no package registers it, or it cannot be imported.
    """
    place = list_registered_places(group).get(name)
    if place is None:
        raise InputError(f"{group}: no installed package registers {name!r}")
    return load_object(f"{group}: {name!r}", place)


def import_scipy() -> None:
    """Import SciPy without the parts of NumPy that only its tests use.

    SciPy's array layer takes over every name of NumPy, which imports f2py, testing, random and
    others for that: more than half of the time of its import.
    """
    import numpy as np

    space: dict[str, Any] = vars(np)
    public, listed = space["__all__"], space["__dir__"]
    space |= {"__all__": [name for name in public if name in space], "__dir__": lambda: [*space]}
    try:
        import_module("scipy.linalg")
    finally:
        space |= {"__all__": public, "__dir__": listed}


class _OneThread:
    """Present uses of one BLAS thread, of which the first sets and the last restores the number."""

    lock = threading.Lock()  # the number of threads is the process's
    uses = 0
    limit: Any = None


@contextmanager
def use_one_blas_thread() -> Iterator[None]:
    """Let the BLAS of NumPy and SciPy work in one thread: two wait for each other at each small
    matrix.

    Threads of Python may use it at the same time. Another library of linear algebra stays as it is.
    """
    with _OneThread.lock:
        if not _OneThread.uses:
            _OneThread.limit = _find_blas().limit(limits=1, user_api="blas")
        _OneThread.uses += 1
    try:
        yield
    finally:
        with _OneThread.lock:
            _OneThread.uses -= 1
            if not _OneThread.uses:
                _OneThread.limit.restore_original_limits()


@functools.cache
def _find_blas() -> Any:
    """Return the controller of the libraries of linear algebra."""
    import_scipy()
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
