"""Faults: killed processes, full disks, two commands at once; nothing is half-written."""

from __future__ import annotations

import os
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from test_hostile_files import COMMAND, SCENARIO, scenario
from tests.jobs import sines

from documents import ROOT
from undeadzone.errors import FileError
from undeadzone.results.run import Run
from undeadzone.util import files
from undeadzone_studies.ensemble import run_blocks
from undeadzone_studies.ensemble.result import Ensemble

VARIED = f'{SCENARIO}\n[ensemble]\nruns = 50\n"sensor.right" = {{ uniform = [0.3, 0.5] }}\n'

WITH_WORKERS = """
import functools, os, pathlib, sys
from tests.jobs import say, sines
from undeadzone_studies.ensemble import run_blocks

if __name__ == "__main__":
    make, path = functools.partial(sines, 605, 0.01), pathlib.Path(sys.argv[1])
    run_blocks.compute_job(make, path, resume=True, workers=2, progress=say).close()
"""


def test_a_write_removes_what_a_killed_one_left_and_no_file_of_another(tmp_path: Path) -> None:
    left = tmp_path / ".undeadzone-a1b2c3d4.txt"
    left.touch()
    with files.replace_file(tmp_path / "a.txt") as held:
        assert held.exists() > left.exists()
        files._remove_leftovers.cache_clear()
        files.write_text("b", tmp_path / "b.txt")
        assert held.exists()
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("error", "kind"),
    [(OSError("axis.so: too short"), OSError), (OSError(28, "no space"), FileError)],
)
def test_only_a_lack_of_room_is_a_matter_of_temporary_files(
    error: OSError, kind: type[Exception]
) -> None:
    with pytest.raises(kind), files.open_scratch():
        raise error


def members(session: int) -> list[int]:
    """The processes of a session that live."""
    alive = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            state, _, _, of = (entry / "stat").read_text().rpartition(") ")[2].split()[:4]
        except OSError:
            continue
        if int(of) == session and state != "Z":
            alive.append(int(entry.name))
    return alive


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
def test_kill_9_of_a_command_with_workers_leaves_no_process_and_changes_no_bit(
    tmp_path: Path,
) -> None:
    def make() -> object:
        return sines(605)

    whole = run_blocks.compute_job(make, tmp_path / "whole.partial")
    path, rng = tmp_path / "runs.partial", random.Random(7)
    command = [sys.executable, "-c", WITH_WORKERS, str(path)]
    for _ in range(3):
        with subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True
        ) as running:
            assert running.stdout is not None
            running.stdout.readline()
            time.sleep(rng.uniform(0, 0.05))  # any instant will do
            running.kill()
            running.stdout.read()  # ends when the last process that holds it has gone
        while members(running.pid):
            time.sleep(0.01)
    run_blocks.compute_job(make, path, resume=True).close()
    assert path.read_bytes() == whole.path.read_bytes()
    whole.close()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs Linux's /proc")
def test_kill_9_of_an_arena_leaves_no_process(tmp_path: Path) -> None:
    mine = scenario(tmp_path, SCENARIO.replace("duration = 0.5", "duration = 500.0"))
    command = [*COMMAND, "arena", str(mine), "--processes", "2", "--seeds", "9"]
    with subprocess.Popen(command, cwd=tmp_path, start_new_session=True) as running:
        while len(members(running.pid)) < 3:  # itself, and two that compute
            assert running.poll() is None
            time.sleep(0.05)
        time.sleep(0.5)
        running.kill()
    while members(running.pid):
        time.sleep(0.02)


JUMPS = """
import itertools, time
years = itertools.cycle([40, -20, 0, 3, -49])
clock = time.time
time.time = lambda: clock() + next(years) * 365 * 86400
"""


def test_an_ensemble_does_not_care_about_a_clock_that_jumps(tmp_path: Path) -> None:
    """Every reading of the clock of the day is years from the last one, in workers too."""
    (tmp_path / "jumps").mkdir()
    (tmp_path / "jumps" / "sitecustomize.py").write_text(JUMPS)
    mine = scenario(tmp_path, VARIED.replace("runs = 50", "runs = 1200"))
    options = ["--workers", "2", "--no-figures", "--out"]
    results = []
    first, again = "first", "with kernels"
    for name, folders, times in (
        ("steady", [], [first]),
        ("jumping", [str(tmp_path / "jumps")], [first, again]),
    ):
        found = os.pathsep.join([*folders, os.environ.get("PYTHONPATH", "")])
        own = {"PYTHONPATH": found, "UNDEADZONE_CACHE": str(tmp_path / f"{name} kernels")}
        for time_of_it in times:
            out = tmp_path / f"{name} {time_of_it}"
            command = [*COMMAND, "ensemble", str(mine), *options, str(out)]
            subprocess.run(command, env=os.environ | own, check=True, capture_output=True)
            results.append(Ensemble.load(out / "runs.npz"))
    for other in results[1:]:
        for column in (*results[0].varied, *results[0].metrics):
            assert other.column(column).tobytes() == results[0].column(column).tobytes()


def limited(size: int) -> Callable[[], None]:
    """What keeps a new process from writing files larger than so many bytes."""

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

    return limit


def split_stderr(stderr: str) -> tuple[list[str], str]:
    """(what an arena says of its size before it starts, the last line)."""
    *announced, last = stderr.splitlines()
    assert all(line.startswith("arena: ") for line in announced)
    return announced, last


@pytest.mark.parametrize(
    "command",
    [
        "run --no-figures",
        "check --no-figures",
        "design --maximise rate --no-figures",
        "ensemble --no-figures",
        "tune --over controller.poles[0]=-9:-5 --runs 2 --budget 4 --no-figures",
        "arena --methods certified --seeds 1 --processes 1",
    ],
)
def test_a_full_disk_is_one_line_and_leaves_nothing_half_written(
    tmp_path: Path, command: str
) -> None:
    mine, out = scenario(tmp_path, VARIED), tmp_path / "out"
    done = subprocess.run(
        [*COMMAND, *command.split(), str(mine), "--out", str(out)],
        preexec_fn=limited(300),
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},  # 300 bytes of it would be read again
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    announced, last = split_stderr(done.stderr)
    assert len(announced) <= 1
    assert last.startswith("undeadzone: ")
    assert "cannot write: File too large" in done.stderr
    assert not out.exists() or list(out.iterdir()) == []


def test_two_runs_into_one_folder_both_end_well(tmp_path: Path) -> None:
    mine, out = scenario(tmp_path, VARIED), tmp_path / "out"
    command = [*COMMAND, "run", str(mine), "--no-figures", "--out", str(out)]
    both = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(2)]
    ends = [process.wait(120) for process in both]
    assert set(ends) <= {0, 1}
    assert sorted(path.name for path in out.iterdir()) == ["run.csv", "run.npz"]
    assert Run.load(out / "run.csv").z.tobytes() == Run.load(out / "run.npz").z.tobytes()


def test_of_two_ensembles_into_one_folder_one_is_refused_or_finds_the_other_done(
    tmp_path: Path,
) -> None:
    mine, out = scenario(tmp_path, VARIED), tmp_path / "out"
    command = [*COMMAND, "ensemble", str(mine), "--no-figures", "--out", str(out)]
    both = [
        subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    stderr_texts = [process.communicate()[1] for process in both]
    ends = [process.returncode for process in both]
    assert 0 in ends
    for code, words in zip(ends, stderr_texts, strict=True):
        assert code == 0 or "another process is writing it" in words
    assert [path.name for path in out.iterdir()] == ["runs.npz"]
    assert Ensemble.load(out / "runs.npz").info.runs == 50
