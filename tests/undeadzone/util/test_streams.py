"""Streams whose descriptors do not block: nothing is lost, and a pause is no end of input."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from live import KALMAN, regular, stream

WATCH = [sys.executable, "-c", "from undeadzone.cli import main; main()", "watch", "lever.toml"]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="descriptors of POSIX")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "lever.toml").write_text(KALMAN, encoding="utf-8")
    return tmp_path


def test_a_reader_that_is_slow_gets_every_line(folder: Path) -> None:
    samples = stream(regular(3000))
    (folder / "samples.csv").write_bytes(samples)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with open(folder / "samples.csv", "rb") as file:
        process = subprocess.Popen(
            WATCH, stdin=file, stdout=writing, stderr=subprocess.DEVNULL, cwd=folder
        )
    os.close(writing)
    received = b""
    while block := os.read(reading, 4096):
        if not received:
            time.sleep(0.5)  # the pipe is full meanwhile
        received += block
    os.close(reading)
    lines = received.split(b"\n")
    assert lines.pop() == b""
    assert len(lines) == 1 + 3000
    assert len({line.count(b",") for line in lines}) == 1  # none is cut
    assert process.wait() in (0, 1)


def test_a_pause_of_the_writer_is_no_end(folder: Path) -> None:
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    process = subprocess.Popen(
        WATCH, stdin=reading, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=folder
    )
    os.close(reading)
    time.sleep(0.5)
    for piece in stream(regular(200)).splitlines(keepends=True):
        os.write(writing, piece)
    os.close(writing)
    received, _ = process.communicate()
    assert received.count(b"\n") == 1 + 200


def test_output_of_a_command_waits_for_its_reader(folder: Path) -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    filled = 0
    try:
        while True:
            filled += os.write(writing, b"x" * 65536)
    except BlockingIOError:
        pass
    process = subprocess.Popen([*WATCH[:3], "--help"], stdout=writing, cwd=folder)
    os.close(writing)
    time.sleep(1.0)
    received = b""
    while block := os.read(reading, 65536):
        received += block
    os.close(reading)
    assert process.wait() == 0
    assert received[filled:].startswith(b"Usage: ")
