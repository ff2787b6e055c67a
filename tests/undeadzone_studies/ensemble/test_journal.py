"""The store of an ensemble keeps what was put and trusts nothing torn, lost or of another job."""

from __future__ import annotations

import functools
import os
import random
import re
import resource
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from tests.jobs import Sines, layout, sines

from documents import ROOT
from traps import refuse_link
from undeadzone.errors import FileError, InputError, ShapeError
from undeadzone_studies.ensemble import journal, run_blocks
from undeadzone_studies.ensemble.journal import Store

pytestmark = pytest.mark.usefixtures("closed_stores")


def stored(path: Path, runs: int = 95, blocks: range | None = None) -> Store:
    """A store with some blocks of `sines`, or all."""
    job = sines(runs)
    store = journal.open_store(path, job.layout)
    for block in reversed(blocks if blocks is not None else range(job.layout.number_of_blocks)):
        store.write_block(block, job.block(block))
    return store


def again(path: Path, runs: int = 95) -> list[int]:
    """The blocks that a second start finds missing."""
    store = journal.open_store(path, layout(runs), resume=True)
    store.close()
    return store.missing_blocks


def test_rows_come_back_as_columns_to_the_last_bit(tmp_path: Path) -> None:
    store = stored(tmp_path / "deep" / "runs.partial")
    job = sines(95)
    rows = np.vstack([job.block(block) for block in range(10)])
    columns = store.map_columns()
    assert list(columns) == ["column 0", "column 1", "column 2"]
    assert np.stack(list(columns.values())).tobytes() == rows.T.tobytes()
    assert all(isinstance(column, np.memmap) for column in columns.values())
    store.remove()
    assert not store.path.exists()
    assert columns["column 1"][3] == rows[3, 1]


def test_a_second_start_finds_what_was_put(tmp_path: Path) -> None:
    store = stored(tmp_path / "runs.partial", blocks=range(3, 10))
    assert store.runs_done == 65
    with pytest.raises(InputError, match="30 of 95 runs are missing"):
        store.map_columns()
    store.close()
    assert again(store.path) == [0, 1, 2]


def test_a_damaged_byte_loses_its_block_and_no_other(tmp_path: Path) -> None:
    store = stored(tmp_path / "runs.partial")
    store.close()
    whole = store.path.read_bytes()
    numbers = 3 * 95 * 8
    rng = random.Random(1)
    for place in [*rng.sample(range(numbers + 80), 40), 0, numbers + 79]:
        damaged = bytearray(whole)
        damaged[store.start + place] ^= 1 << rng.randrange(8)
        store.path.write_bytes(damaged)
        if place < numbers:
            run = place // 8 % 95
            assert again(store.path) == [run // 10]
        else:
            assert again(store.path) == [(place - numbers) // 8]


def test_rows_in_the_wrong_block_are_not_believed(tmp_path: Path) -> None:
    store = journal.open_store(tmp_path / "runs.partial", layout(100))
    for block in range(10):
        store.write_block(block, np.ones((10, 3)))
    store.close()
    with open(store.path, "r+b") as file:
        file.seek(store.start + 3 * 100 * 8)
        first = file.read(8)
        file.write(first)
    assert again(store.path, 100) == [1]


@pytest.mark.parametrize("length", [100, 3000, 5000, 6300])
def test_a_file_cut_short_is_completed(tmp_path: Path, length: int) -> None:
    whole = run_blocks.compute_job(functools.partial(sines, 95), tmp_path / "whole.partial")
    store = stored(tmp_path / "runs.partial")
    store.close()
    os.truncate(store.path, length)
    if length < 200:  # the header itself is torn
        words = "is not an unfinished ensemble. Choose another name or delete it"
        with pytest.raises(FileError, match=words):
            again(store.path)
        return
    run_blocks.compute_job(functools.partial(sines, 95), store.path, resume=True).close()
    assert store.path.read_bytes() == whole.path.read_bytes()


@pytest.mark.parametrize("content", [b"", bytes(10_000)])
def test_a_file_whose_header_was_never_written_is_begun_anew(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "runs.partial"
    path.write_bytes(content)
    assert run_blocks.compute_job(functools.partial(sines, 95), path).runs_done == 95


def test_what_is_there_is_not_overwritten_without_resume(tmp_path: Path) -> None:
    store = stored(tmp_path / "runs.partial")
    store.close()
    words = (
        "an unfinished ensemble is there. Continue it with resume=True, or delete it to start anew"
    )
    with pytest.raises(FileError, match=words):
        journal.open_store(store.path, store.layout)
    assert again(store.path) == []


@pytest.mark.parametrize(
    "content", [b"time,z\n0,1\n", b"\x89PNG\r\n\x1a\n", b"[1, 2]\n", b'{"runs": 3}\n']
)
@pytest.mark.parametrize("resume", [False, True])
def test_another_file_is_left_alone(tmp_path: Path, content: bytes, resume: bool) -> None:
    path = tmp_path / "runs.partial"
    path.write_bytes(content)
    with pytest.raises(FileError, match="is not an unfinished ensemble"):
        journal.open_store(path, layout(95), resume)
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (layout(95, seed=3), "seed: 3 there, 0 here"),
        (layout(96), "runs: 96 there, 95 here"),
        (layout(95, block=20), "block: 20 there, 10 here"),
        (layout(95, scenario="a = 1\nb = 4\n"), "scenario: b = 4 there, b = 2 here"),
        (layout(95, scenario="a = 1\n"), "scenario: nothing there, b = 2 here"),
        (layout(95, scenario="a = 1\nb = 2\n\n"), "scenario:  there, nothing here"),
        (layout(95, extra=1), "extra: 1 there, None here"),
        (
            layout(95, columns=2),
            "columns: ['column 0', 'column 1'] there, ['column 0', 'column 1', 'column 2'] here",
        ),
    ],
)
def test_another_problem_is_refused_with_the_difference(
    tmp_path: Path, other: journal.Layout, difference: str
) -> None:
    journal.open_store(tmp_path / "runs.partial", other).close()
    words = re.escape(f"holds another problem ({difference}); delete it to start anew")
    with pytest.raises(InputError, match=words):
        again(tmp_path / "runs.partial")


def test_other_versions_of_packages_are_another_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored(tmp_path / "runs.partial").close()
    monkeypatch.setattr(journal, "package_versions", lambda: {"llvmlite": "0.1"})
    with pytest.raises(InputError, match=r"llvmlite: [\d.]+ there, 0\.1 here"):
        again(tmp_path / "runs.partial")


def test_a_long_scenario_in_the_header(tmp_path: Path) -> None:
    long = layout(20, scenario="x = 1\n" * 400_000)
    journal.open_store(tmp_path / "runs.partial", long).close()
    assert journal.open_store(tmp_path / "runs.partial", long, resume=True).missing_blocks == [0, 1]


def test_a_store_in_use_is_refused(tmp_path: Path) -> None:
    store = stored(tmp_path / "runs.partial", blocks=range(2))
    words = "another process is writing it. Wait for it, or choose another name"
    for resume in (False, True):
        with pytest.raises(FileError, match=words):
            journal.open_store(store.path, store.layout, resume)
    store.write_block(2, sines(95).block(2))
    store.close()
    assert again(store.path) == list(range(3, 10))


def test_rows_of_another_shape_are_refused(tmp_path: Path) -> None:
    store = stored(tmp_path / "runs.partial", blocks=range(9))
    with pytest.raises(ShapeError, match="block 9: expected 5 x 3, found 10 x 3"):
        store.write_block(9, np.ones((10, 3)))


@contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """No file of this process may grow beyond `size`: a test's nearest thing to a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_is_noticed_at_the_start(tmp_path: Path) -> None:
    words = r"runs\.partial: cannot write: File too large$"
    with file_size_limit(50_000), pytest.raises(FileError, match=words):
        run_blocks.compute_job(functools.partial(sines, 10_000), tmp_path / "runs.partial")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FileError, match=r"runs\.partial: cannot write: "):
        journal.open_store(tmp_path / "runs.partial", layout(10**17))
    assert list(tmp_path.iterdir()) == []


def test_a_store_takes_disk_as_blocks_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """20,000,000 runs take 1.6 GB in the end, and nothing before they are computed."""
    job = sines(20_000_000)
    store = journal.open_store(tmp_path / "runs.partial", job.layout)
    assert store.size_in_bytes > 4e8
    for block in range(3):
        store.write_block(block, job.block(block))
    assert store.path.stat().st_blocks * 512 < 1e6
    store.close()
    resumed = journal.open_store(store.path, job.layout, resume=True)
    assert resumed.runs_done == 30
    resumed.close()
    disk = os.statvfs(tmp_path)
    small = os.statvfs_result((*disk[:4], 100, *disk[5:]))
    monkeypatch.setattr(os, "fstatvfs", lambda descriptor: small)
    with pytest.raises(FileError, match=r"it needs [\d,]+ MB, and the disk has"):
        journal.open_store(tmp_path / "more.partial", job.layout)
    assert not (tmp_path / "more.partial").exists()


def test_a_disk_that_fails_midway_keeps_what_was_put(tmp_path: Path) -> None:
    def progress(runs: int) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    path = tmp_path / "runs.partial"
    words = "cannot write: File too large; 10 of 95 runs are kept in .*; continue with resume=True"
    try:
        with pytest.raises(FileError, match=words):
            run_blocks.compute_job(functools.partial(sines, 95), path, progress=progress)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert again(path) == list(range(1, 10))


def test_unwritable_places(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name in ("", "file/runs.partial", "zero\0byte", "x" * 300):
        with pytest.raises(FileError, match="cannot write"):
            journal.open_store(tmp_path / name, layout(95))


@pytest.mark.parametrize("link", ["symlink_to", "hardlink_to"])
def test_nothing_is_written_through_links(tmp_path: Path, link: str) -> None:
    layout = sines(605).layout
    refuse_link(tmp_path / "runs.partial", link, lambda path: journal.open_store(path, layout))


def test_stored_runs_are_for_their_owner(tmp_path: Path) -> None:
    store = journal.open_store(tmp_path / "runs.partial", sines(605).layout)
    store.close()
    assert stat.S_IMODE(store.path.stat().st_mode) == 0o600


def test_a_removed_store_is_noticed(tmp_path: Path) -> None:
    store = stored(tmp_path / "folder" / "runs.partial", blocks=range(2))
    store.path.unlink()
    store.path.parent.rmdir()
    with pytest.raises(FileError, match=r"runs\.partial: cannot write: it was removed"):
        store.write_block(2, sines(95).block(2))


class Interrupted(Sines):
    """Ctrl-C in the sixth block."""

    def block(self, index: int, threads: int | None = None) -> np.ndarray:
        if index == self.wrong:
            raise KeyboardInterrupt
        return super().block(index)


def test_ctrl_c_reports_what_is_stored_and_how_to_continue(tmp_path: Path) -> None:
    path, progress = tmp_path / "runs.partial", []
    words = r"50 of 95 runs are kept in .*runs\.partial; continue with resume=True"
    with pytest.raises(KeyboardInterrupt, match=words):
        run_blocks.compute_job(lambda: Interrupted(layout(95), wrong=5), path)
    store = run_blocks.compute_job(
        functools.partial(sines, 95), path, resume=True, progress=progress.append
    )
    assert progress == [50, 10, 10, 10, 10, 5]
    assert store.done.all()


def test_what_stops_the_use_of_a_store_keeps_it(tmp_path: Path) -> None:
    store = run_blocks.compute_job(functools.partial(sines, 95), tmp_path / "runs.partial")
    words = r"^no such suffix; 95 of 95 runs are kept in .*; continue with resume=True$"
    with pytest.raises(InputError, match=words), run_blocks.close_on_failure(store):
        raise InputError("no such suffix")
    assert again(store.path) == []


def test_what_stops_before_the_first_block_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt, match=r"^$"):
        run_blocks.compute_job(lambda: Interrupted(layout(95), wrong=0), tmp_path / "runs.partial")
    with pytest.raises(ArithmeticError):
        run_blocks.compute_job(functools.partial(sines, 95, wrong=0), tmp_path / "runs.partial")
    assert list(tmp_path.iterdir()) == []


def program(path: Path, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.jobs", str(path), *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def test_kill_9_at_random_moments_changes_no_bit(tmp_path: Path) -> None:
    runs, seconds = 400, 0.02
    whole = run_blocks.compute_job(functools.partial(sines, runs), tmp_path / "whole.partial")
    path, rng, found = tmp_path / "runs.partial", random.Random(4), []
    for _ in range(5):
        with program(path, runs, seconds) as running:
            assert running.stdout is not None
            found.append(int(running.stdout.readline()))
            for _ in range(rng.randrange(5)):
                running.stdout.readline()
            time.sleep(rng.uniform(0, seconds))
            running.kill()
    with program(path, runs, seconds) as running:
        printed = running.communicate()[0].split()
    assert running.returncode == 0
    assert found[0] == 10
    assert int(printed[0]) >= max(found) > 10
    assert sum(map(int, printed[:-1])) == runs
    assert path.read_bytes() == whole.path.read_bytes()


def test_memory_does_not_grow_with_the_runs(tmp_path: Path) -> None:
    sizes = []
    for runs in (10_000, 2_000_000):  # 0.24 MB, 48 MB
        with program(tmp_path / f"{runs}.partial", runs, 0, 10_000) as running:
            sizes.append(int(running.communicate()[0].split()[-1]))
    assert sizes[1] < sizes[0] + 10_000  # [kB]


IMPORTS = """
import sys
sys.modules["fcntl"] = sys.modules["distributed"] = None
import undeadzone_studies.ensemble.run_blocks
print([name for name in ("llvmlite", "scipy", "casadi", "dask") if name in sys.modules])
"""


def test_imports() -> None:
    command = [sys.executable, "-c", IMPORTS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
