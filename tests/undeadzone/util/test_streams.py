"""Standard streams that do not block: nothing is lost, and a pause is no end."""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import commands
from undeadzone.cli.watch import SavedWatch
from undeadzone.errors import FileError
from undeadzone.util.streams import WaitingFile

COMMAND = [*commands.COMMAND, "watch"]
SCENARIO = """
[plant]
A = [[0.0, 1.0], [-1.0, -2.0]]
B = [[0.0], [1.0]]
C = [[1.0, 0.0]]
[sensor]
right = 1.0
left = 0.7
noise = 0.01
[observer]
method = "kalman"
right = [0.0, 3.0]
[simulation]
time = "sampled"
step = 0.01
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no O_NONBLOCK")


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    """A scenario that follows a log."""
    path = tmp_path / "s.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


def samples(count: int) -> bytes:
    return b"t,u,y\n" + b"".join(b"%.2f,%d,0.5\n" % (k * 0.01, k % 7 - 3) for k in range(count))


def test_every_line_comes_through_a_pipe_that_does_not_block(scenario: Path) -> None:
    log = scenario.with_name("log.csv")
    log.write_bytes(samples(20_000))
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with log.open("rb") as stdin:
        process = subprocess.Popen(
            [*COMMAND, scenario], stdin=stdin, stdout=writing, stderr=subprocess.DEVNULL
        )
    os.close(writing)
    time.sleep(3.0)  # the pipe is full by then
    with open(reading, "rb") as pipe:
        lines = pipe.read().splitlines()
    process.wait()
    assert len(lines) == 20_001
    assert len({line.count(b",") for line in lines}) == 1


def stop_ignoring_hangup() -> None:
    """Undo `nohup`, under which a process inherits that it ignores SIGHUP."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_a_pause_on_stdin_is_no_end_and_a_hangup_saves(scenario: Path) -> None:
    state = scenario.with_name("state.npz")
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    with subprocess.Popen(
        [*COMMAND, scenario, "--state", state],
        stdin=reading,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=stop_ignoring_hangup,
    ) as process:
        os.close(reading)
        assert process.stdout is not None
        os.write(writing, samples(10))
        for _ in range(11):
            process.stdout.readline()
        time.sleep(0.5)
        os.write(writing, b"0.10,1,0.5\n")
        assert process.stdout.readline().startswith(b"0.1,")
        time.sleep(0.5)  # it waits for more by then
        process.send_signal(signal.SIGHUP)
        _, stderr_text = process.communicate()
    assert process.returncode == 143, stderr_text
    assert state.exists(), stderr_text
    os.close(writing)


def test_writes_are_whole_and_reads_wait() -> None:
    reading, writing = os.pipe()
    for end in (reading, writing):
        os.set_blocking(end, False)
    data = os.urandom(1_000_000)

    def feed() -> None:
        with WaitingFile(writing, "w") as raw:
            left = memoryview(data)
            while left:
                left = left[raw.write(left) :]

    feeder = threading.Thread(target=feed)
    feeder.start()
    with io.BufferedReader(WaitingFile(reading)) as pipe:
        assert pipe.read(len(data)) == data
    feeder.join()


def test_a_failed_save_is_reported_and_repeated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part: Any = SimpleNamespace(SAVED=("count",), count=1, digest="d")
    part.clock = part.reader = part
    watch = SavedWatch(tmp_path / "gone" / "state.npz", 0.0, part, part)
    shutil.rmtree(tmp_path / "gone")
    (tmp_path / "gone").touch()  # no folder can be made there
    watch.save_state(when_due=True)
    watch.save_state(when_due=True)
    assert "not saved, 2 times by now" in capsys.readouterr().err
    with pytest.raises(FileError):
        watch.save_state()
    (tmp_path / "gone").unlink()
    watch.save_state(when_due=True)
    assert (tmp_path / "gone" / "state.npz").exists()
    with watch.lock:
        pass


def test_one_watch_a_state(tmp_path: Path) -> None:
    part: Any = SimpleNamespace(SAVED=("count",), count=1, digest="d")
    part.clock = part.reader = part
    first = SavedWatch(tmp_path / "state.npz", 0.0, part, part)
    with pytest.raises(FileError, match="another process is writing it"):
        SavedWatch(tmp_path / "state.npz", 0.0, part, part)
    with first.lock:
        pass
    with SavedWatch(tmp_path / "state.npz", 0.0, part, part).lock:
        pass


def test_a_reader_that_leaves_ends_a_watch_in_silence(scenario: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [*COMMAND, str(scenario)]
    done = subprocess.run(command, input=samples(50), stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")
