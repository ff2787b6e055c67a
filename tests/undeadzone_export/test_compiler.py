"""The host's compiler: what it leaves goes with the command that started it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from documents import EXAMPLES

EXAMPLE = EXAMPLES / "asymmetric_noise.toml"
# As gcc does: a temporary file, a process of its own that computes, and no end for a while.
SLOW = """#!/bin/sh
touch "$TMPDIR/cc1234.s"
sleep 300 &
echo $! > "$STARTED"
wait
"""


def is_running(pid: int) -> bool:
    """Whether a process runs; one that has ended and waits for its parent does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_command_takes_the_compiler_along(tmp_path: Path, stop: int) -> None:
    compiler, started, scratch = tmp_path / "slow", tmp_path / "started", tmp_path / "scratch"
    compiler.write_text(SLOW)
    compiler.chmod(0o700)
    scratch.mkdir()
    command = [sys.executable, "-c", "from undeadzone.cli import main; main()", "export"]
    out = tmp_path / "firmware"
    running = subprocess.Popen(
        [*command, str(EXAMPLE), "--out", str(out)],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"CC": str(compiler), "TMPDIR": str(scratch), "STARTED": str(started)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    with running:
        while not (started.exists() and started.read_text().strip()):
            assert running.poll() is None, running.stderr
            time.sleep(0.05)
        assert [path.name for path in scratch.rglob("*.s")] == ["cc1234.s"]
        running.send_signal(stop)
        _, stderr_text = running.communicate(timeout=60)
    word, code = ("interrupted", 130) if stop == signal.SIGINT else ("terminated", 143)
    assert (running.returncode, stderr_text) == (code, f"undeadzone: {word}\n")
    assert not list(scratch.iterdir())
    assert not is_running(int(started.read_text()))
