"""Kernels on disk are machine code: nobody else's is run, and the folder does not grow for ever."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from undeadzone.compile import cache, cache_folder

KINDS = ("float64", "float64*")
SOURCE = """
define void @block(double %value, ptr %result) {{
  %product = fmul double {factor:e}, %value
  store double %product, ptr %result
  ret void
}}
"""
PLANTED = -3.0  # what planted code gives, 6 what the source says


def computed(factor: float = 2.0) -> tuple[float, bool]:
    """(factor * 3 computed by a kernel, whether it was taken from disk)."""
    cache.load_or_compile.cache_clear()
    block = cache.load_block(SOURCE.format(factor=factor), KINDS)
    result = np.zeros(1)
    block(3.0, result)
    return float(result[0]), not block.text


def plant(folder: Path) -> Path:
    """Other code, with its right digest, under the name of the kernel of `computed()`."""
    computed()
    (honest,) = folder.iterdir()
    honest_bytes = honest.read_bytes()
    computed(PLANTED / 3.0)
    (other,) = set(folder.iterdir()) - {honest}
    honest.write_bytes(other.read_bytes())
    other.unlink()
    assert honest.read_bytes() != honest_bytes
    return honest


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_this_users_own_file_is_trusted_since_the_digest_is_no_key(folder: Path) -> None:
    plant(folder)
    assert computed() == (PLANTED, True)


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_folder_and_files_are_this_users_alone_whatever_the_umask(folder: Path, umask: int) -> None:
    before = os.umask(umask)
    try:
        computed()
    finally:
        os.umask(before)
    (kernel,) = folder.iterdir()
    assert (mode(folder), mode(kernel)) == (0o700, 0o600)


def test_a_folder_of_this_user_that_others_may_read_is_closed(folder: Path) -> None:
    folder.mkdir(mode=0o755)
    assert computed() == (6.0, False)
    assert mode(folder) == 0o700
    assert computed() == (6.0, True)


def writable_file(folder: Path, kernel: Path) -> None:
    kernel.chmod(0o620)


def file_for_everybody(folder: Path, kernel: Path) -> None:
    kernel.chmod(0o602)


def writable_folder(folder: Path, kernel: Path) -> None:
    folder.chmod(0o777)


def folder_of_a_group(folder: Path, kernel: Path) -> None:
    folder.chmod(0o770)


def linked_file(folder: Path, kernel: Path) -> None:
    kernel.rename(folder.parent / "elsewhere")
    kernel.symlink_to(folder.parent / "elsewhere")


def file_with_two_names(folder: Path, kernel: Path) -> None:
    os.link(kernel, folder.parent / "elsewhere")


def linked_folder(folder: Path, kernel: Path) -> None:
    folder.rename(folder.parent / "elsewhere")
    folder.symlink_to(folder.parent / "elsewhere")


def pipe(folder: Path, kernel: Path) -> None:
    kernel.unlink()
    os.mkfifo(kernel, 0o600)


@pytest.mark.parametrize(
    "spoil",
    [
        writable_file,
        file_for_everybody,
        writable_folder,
        folder_of_a_group,
        linked_file,
        file_with_two_names,
        linked_folder,
        pipe,
    ],
)
def test_what_others_could_have_written_is_not_run(
    folder: Path, spoil: Callable[[Path, Path], None]
) -> None:
    spoil(folder, plant(folder))
    assert computed() == (6.0, False)


@pytest.mark.parametrize("spoil", [writable_folder, folder_of_a_group, linked_folder])
def test_nothing_is_stored_in_a_folder_of_others(
    folder: Path, spoil: Callable[[Path, Path], None]
) -> None:
    kernel = plant(folder)
    before = kernel.read_bytes()
    spoil(folder, kernel)
    computed()
    assert [path.read_bytes() for path in folder.iterdir()] == [before]


def test_what_another_user_owns_is_not_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plant(folder)
    someone = os.geteuid() + 1
    monkeypatch.setattr(os, "geteuid", lambda: someone)
    assert computed() == (6.0, False)


@pytest.mark.parametrize("variable", ["UNDEADZONE_CACHE", "XDG_CACHE_HOME", "HOME"])
def test_a_relative_folder_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str
) -> None:
    for name in ("UNDEADZONE_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv(variable, "here")
    monkeypatch.chdir(tmp_path)
    directory = cache_folder.cache_directory()
    assert directory is None or directory.is_relative_to(tmp_path / "home")
    assert (directory is None) == (variable == "HOME")
    assert computed() == (6.0, False)
    assert not (tmp_path / "here").exists()


def test_where_kernels_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDEADZONE_CACHE", "/here")
    assert cache_folder.cache_directory() == Path("/here")
    monkeypatch.delenv("UNDEADZONE_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/there")
    assert cache_folder.cache_directory() == Path("/there/undeadzone")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/someone")
    assert cache_folder.cache_directory() == Path("/home/someone/.cache/undeadzone")


def aged(folder: Path, days: dict[str, float]) -> None:
    """Files of ten bytes, last used so many days ago."""
    folder.mkdir(mode=0o700)
    for name, age in days.items():
        (folder / name).write_bytes(bytes(10))
        used = time.time() - 86400 * age
        os.utime(folder / name, (used, used))


def left(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_what_nobody_used_for_long_is_deleted_when_something_is_written(folder: Path) -> None:
    ages = {"old.kernel": 91.0, ".half.kernel": 91.0, "new.kernel": 89.0, "other.txt": 400.0}
    aged(folder, ages)
    assert cache_folder.read_kernel_file(folder, "new.kernel") == bytes(10)
    assert left(folder) == set(ages)
    cache_folder.write_kernel_file(folder, "now.kernel", b"code")
    assert left(folder) == {"new.kernel", "other.txt", "now.kernel"}


def test_of_too_many_bytes_the_least_recently_used_go_first(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache_folder, "LARGEST", 25)
    aged(folder, {"a.kernel": 3.0, "b.kernel": 2.0, "c.kernel": 1.0, "d.kernel": 0.5})
    assert cache_folder.read_kernel_file(folder, "a.kernel") == bytes(10)  # used just now
    cache_folder.write_kernel_file(folder, "now.kernel", bytes(1000))
    assert left(folder) == {"a.kernel", "d.kernel", "now.kernel"}
