"""Blocks computed by processes of this computer: the same bits, no open port, no Dask."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from tests.jobs import Sines, layout, say, sines, stop_program

from documents import ROOT
from undeadzone.errors import ClusterError, InputError
from undeadzone_studies.ensemble import journal, local_workers, run_blocks

pytestmark = pytest.mark.usefixtures("closed_stores")


def test_they_give_the_same_bits(tmp_path: Path, whole: bytes) -> None:
    progress: list[int] = []
    make, path = functools.partial(sines, 605, 0.002), tmp_path / "runs.partial"
    run_blocks.compute_job(make, path, workers=2, progress=progress.append).close()
    assert path.read_bytes() == whole
    assert sum(progress) == 605


def test_others_continue_what_one_process_began(
    tmp_path: Path, whole: bytes, elsewhere: dict[str, Any]
) -> None:
    path, trace = tmp_path / "runs.partial", tmp_path / "trace"
    job = sines(605)
    begun = journal.open_store(path, job.layout)
    for block in (0, 7, 60):
        begun.write_block(block, job.block(block))
    begun.close()
    trace.mkdir()
    make = functools.partial(sines, 605, 0.0, trace)
    run_blocks.compute_job(make, path, resume=True, **elsewhere).close()
    assert {int(block.name) for block in trace.iterdir()} == set(range(61)) - {0, 7, 60}
    assert path.read_bytes() == whole


def test_they_need_no_dask(tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    path = tmp_path / "runs.partial"
    run_blocks.compute_job(functools.partial(sines, 605), path, workers=1).close()
    assert path.read_bytes() == whole


def children() -> list[int]:
    """The processes that this one started and that live."""
    listed = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return [int(child) for child in listed]


def sockets(process: int) -> set[str]:
    """The sockets with which a process listens to others."""
    tables = [Path(f"/proc/{process}/net/{name}") for name in ("tcp", "tcp6")]
    rows = [line.split() for one in tables if one.exists() for line in one.read_text().splitlines()]
    listening = {f"socket:[{row[9]}]" for row in rows if row[3] == "0A"}
    open_ones = set()
    for descriptor in Path(f"/proc/{process}/fd").iterdir():
        try:
            open_ones.add(os.readlink(descriptor))
        except FileNotFoundError:
            continue
    return open_ones & listening


@pytest.mark.skipif(
    not Path(f"/proc/self/task/{os.getpid()}/children").exists(), reason="needs Linux's /proc"
)
def test_no_process_opens_a_socket(tmp_path: Path) -> None:
    before, others = sockets(os.getpid()), set(children())
    seen: list[set[str]] = []

    def look(runs: int) -> None:
        started = set(children()) - others
        if len(started) == 2:  # the list is short where a process ends at the same time
            seen.append(set().union(*map(sockets, [*started, os.getpid()])))

    make, path = functools.partial(sines, 605, 0.001), tmp_path / "runs.partial"
    run_blocks.compute_job(make, path, workers=2, progress=look).close()
    assert seen
    assert set().union(*seen) <= before
    assert set(children()) <= others


def test_a_worker_that_is_killed_changes_no_bit(
    tmp_path: Path, whole: bytes, elsewhere: dict[str, Any]
) -> None:
    path, trace = tmp_path / "runs.partial", tmp_path / "trace"
    trace.mkdir()
    make = functools.partial(sines, 605, 0.02, trace, deadly=30)
    run_blocks.compute_job(make, path, **elsewhere).close()
    assert (trace / "30").exists()
    assert path.read_bytes() == whole


def test_an_error_of_a_block_arrives_and_the_others_are_stored(
    tmp_path: Path, whole: bytes, elsewhere: dict[str, Any]
) -> None:
    path = tmp_path / "runs.partial"
    with pytest.raises(ArithmeticError, match="a block that fails"):
        run_blocks.compute_job(functools.partial(sines, 605, wrong=40), path, **elsewhere)
    store = journal.open_store(path, sines(605).layout, resume=True)
    store.close()
    assert 0 < store.runs_done < 605
    run_blocks.compute_job(functools.partial(sines, 605), path, resume=True, **elsewhere).close()
    assert path.read_bytes() == whole


class Lethal(Sines):
    """Every block kills its process."""

    def block(self, index: int, threads: int | None = None) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


def lethal() -> Lethal:
    return Lethal(layout(605))


def killed_at_the_start() -> Sines:
    """A job here, the end of any other process that prepares it."""
    if os.environ["TEST_PROCESS"] != str(os.getpid()):
        os.kill(os.getpid(), signal.SIGKILL)
    return sines(605)


@pytest.mark.parametrize("make", [lethal, killed_at_the_start])
def test_workers_that_die_again_and_again_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make: functools.partial[Sines]
) -> None:
    monkeypatch.setenv("TEST_PROCESS", str(os.getpid()))
    words = "^2 local workers: 4 workers died one after the other at the same blocks"
    with pytest.raises(ClusterError, match=words):
        run_blocks.compute_job(make, tmp_path / "runs.partial", workers=2)
    assert list(tmp_path.iterdir()) == []


def test_workers_that_cannot_be_started_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no-python"))
    words = "^local workers: cannot be started: No such file or directory$"
    with pytest.raises(ClusterError, match=words):
        run_blocks.compute_job(functools.partial(sines, 605), tmp_path / "runs.partial", workers=2)
    assert list(tmp_path.iterdir()) == []


class Unreadable(Exception):
    """An exception that pickle writes and cannot read."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} {other}")


class Failing(Sines):
    """Every block raises what cannot be sent."""

    def block(self, index: int, threads: int | None = None) -> None:
        raise Unreadable("not", "readable")


def failing() -> Failing:
    return Failing(layout(605))


def test_an_exception_that_cannot_be_sent_arrives_in_words(tmp_path: Path) -> None:
    with pytest.raises(ClusterError, match=r"^a local worker: Unreadable: not readable$"):
        run_blocks.compute_job(failing, tmp_path / "runs.partial", workers=1)


class Talkative(Sines):
    """Blocks that print."""

    def block(self, index: int, threads: int | None = None) -> None:
        say(index)
        return super().block(index)


def talkative() -> Talkative:
    return Talkative(layout(605))


def test_what_a_block_prints_does_not_end_up_among_its_numbers(
    tmp_path: Path, whole: bytes
) -> None:
    path = tmp_path / "runs.partial"
    run_blocks.compute_job(talkative, path, workers=2).close()
    assert path.read_bytes() == whole


def test_workers_import_nothing_from_the_folder_where_they_are_started(
    tmp_path: Path, whole: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pickle", "numpy", "undeadzone"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('planted')\n")
    monkeypatch.chdir(tmp_path)
    here = [path for path in sys.path if path]
    monkeypatch.setattr(sys, "path", [str(ROOT), *here])
    path = tmp_path / "runs.partial"
    run_blocks.compute_job(functools.partial(sines, 605), path, workers=1).close()
    assert path.read_bytes() == whole


@pytest.mark.parametrize("options", [{"workers": 0}, {"workers": 2, "cluster": "127.0.0.1:9"}])
def test_wrong_numbers_of_workers(tmp_path: Path, options: dict[str, int]) -> None:
    words = (
        "workers, cluster: expected a number of local processes, 1 or more, or an address, found "
    )
    with pytest.raises(InputError, match=words):
        run_blocks.compute_job(functools.partial(sines, 605), tmp_path / "runs.partial", **options)


def test_a_worker_ends_with_the_process_that_started_it() -> None:
    command = [sys.executable, "-P", "-c", local_workers.BEGIN]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as worker:
        local_workers._send_parts(worker, sys.path, b"")
        assert worker.stdin is not None
        worker.stdin.close()
        assert worker.wait(60) == 0


INTERRUPTIBLE = """
import functools, pathlib, signal, sys
from tests.jobs import say, sines
from undeadzone_studies.ensemble import run_blocks

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a background job
    make, path = functools.partial(sines, 605, 0.05), pathlib.Path(sys.argv[1])
    try:
        run_blocks.compute_job(make, path, workers=2, progress=say)
    except KeyboardInterrupt as error:
        say(error)
"""


def test_ctrl_c_stops_the_workers_quietly(tmp_path: Path, whole: bytes) -> None:
    path = tmp_path / "runs.partial"
    _, output, noise = stop_program(signal.SIGINT, INTERRUPTIBLE, path)  # as a terminal does
    assert "of 605 runs are kept in" in output
    assert noise == ""
    run_blocks.compute_job(functools.partial(sines, 605), path, resume=True).close()
    assert path.read_bytes() == whole


def test_calls_of_a_function_arrive_by_number() -> None:
    results = local_workers.iterate_results(2, pow, {3: (2, 5), 7: (3, 2), 1: (5, 0)})
    assert dict(results) == {3: 32, 7: 9, 1: 1}


def test_calls_whose_workers_die_are_one_line() -> None:
    words = "^2 local workers: 4 workers died one after the other"
    with pytest.raises(ClusterError, match=words):
        list(local_workers.iterate_results(2, os._exit, {0: (1,), 1: (1,)}))


@pytest.mark.skipif(
    not Path(f"/proc/self/task/{os.getpid()}/children").exists(), reason="needs Linux's /proc"
)
def test_whoever_stops_waits_for_no_call() -> None:
    """SIGTERM during `arena --tune` waited until every method was tuned."""
    others = set(children())
    calls = {0: (0.0,), 1: (1e5,), 2: (1e5,), 3: (1e5,)}
    results = local_workers.iterate_results(2, time.sleep, calls)
    assert next(results) == (0, None)
    assert len(set(children()) - others) == 2
    results.close()
    assert set(children()) <= others
