"""`undeadzone watch` fed without a pause: its rate, and its memory at tenths of the way.

`python -m benchmarks long_watch --lines 100000` is a short one.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
import time
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from tests.live import KALMAN, STEP, line

from benchmarks.markdown import head, row

BLOCK = 10_000  # lines that are written at once


def table(lines: int = 10_000_000) -> str:
    """Rate and memory of one watch."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "lever.toml"
        path.write_text(KALMAN)
        command = [sys.executable, "-m", "undeadzone", "watch", str(path)]
        began = time.perf_counter()
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as running:
            assert running.stdin is not None
            assert running.stdout is not None
            counted: list[int] = []
            reader = threading.Thread(target=_count, args=(running.stdout, counted))
            reader.start()
            memory = _feed(running, running.stdin, lines)
            reader.join()
        seconds = time.perf_counter() - began
    sizes = ", ".join(f"{size:.0f}" for size in memory)
    cells = (f"{lines:,}", f"{sum(counted) - 1:,}", f"{lines / seconds:,.0f}", sizes)
    title = "## A long watch\n"
    words = head("lines in", "estimates out", "lines/s", "resident memory at tenths [MB]")
    return "\n".join([title, *words, row(*cells), ""])


def _count(stream: BufferedReader, counted: list[int]) -> None:
    """Count the lines of a stream until it ends."""
    while piece := stream.read1(1 << 20):
        counted.append(piece.count(b"\n"))


def _feed(running: subprocess.Popen[bytes], stdin: BinaryIO, lines: int) -> list[float]:
    """Write lines, one in a thousand damaged; the resident memory [MB] at tenths of the way."""
    memory = []
    stdin.write(b"t,y,u\n")
    for first in range(0, lines, BLOCK):
        text = [line(STEP * k) for k in range(first, min(first + BLOCK, lines))]
        text[::1000] = [b"nonsense\n"] * len(text[::1000]) if first else text[::1000]
        stdin.write(b"".join(text))
        if first % (lines // 10) == 0:
            memory.append(_resident(running.pid))
    memory.append(_resident(running.pid))
    stdin.close()
    return memory


def _resident(pid: int) -> float:
    """The resident memory of a process [MB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    (size,) = [line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")]
    return int(size) / 1000
