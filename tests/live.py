"""Live logs: lines of samples, lines that are wrong, and a watch that is fed in pieces."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from undeadzone.errors import FileError
from undeadzone.logs.names import parse_columns
from undeadzone.scenario.reader import read_for_logs
from undeadzone.simulation.follower import Follower, LiveLog

KALMAN = """
title = "A lever"
[plant]
A = [[0, 1], [-1, -2]]
B = [[0], [1]]
C = [[1, 0]]
[sensor]
noise = 0.02
[observer]
method = "kalman"
right = [0.0, 2.0]
[simulation]
step = 0.01
"""
STEP = 0.01


def line(t: float) -> bytes:
    """A sample at a time [s]; what it holds depends on that."""
    return b"%.9g,%.6f,%.6f\n" % (t, np.sin(3 * t), np.cos(2 * t))


def stream(times: list[float]) -> bytes:
    return b"t,y,u\n" + b"".join(map(line, times))


def regular(count: int, first: float = 0.0) -> list[float]:
    return [round(first + STEP * k, 9) for k in range(count)]


WRONG_LINES: Final = [
    b"",
    b"words\n",
    b"1,2\n",
    b"\0,\0\n",
    b"\xff\xfe\n",
    b",1,2\n",
    b"1e12,1,2\n",
    b"-5,1,2\n",
    b"0.005,1,2\n",
    b"0.4,1,1e400\n",
    b"# a remark\r",
    b"8" * 70_000 + b"\n",
    line(0.1),
    line(0.9),
    line(1e4),
    line(7.0) + line(7.01) + line(7.02),
]


class Watched:
    """What a watch gives: rows of estimates, then what the log comes to or the message."""

    def __init__(self, path: Path, strict: bool = False) -> None:
        self.follower = Follower(read_for_logs(path), live=True)
        self.log = LiveLog("log", read_for_logs(path), self.follower, parse_columns(None), strict)
        self.parts = {"follower": self.follower, "clock": self.log.clock, "reader": self.log.reader}
        self.out = io.BytesIO()

    def feed(self, data: bytes, last: bool = False) -> None:
        for begins, samples in self.log.pieces(data, last):
            if begins:
                self.follower.restart()
            estimate, sides, _ = self.follower.follow(samples)
            self.out.write(np.column_stack([samples.t, *estimate, sides]).tobytes())

    def ended(self) -> tuple[bytes, str]:
        try:
            self.feed(b"", last=True)
            message = repr(self.log.info(self.follower))
        except FileError as error:
            message = str(error)
        return self.out.getvalue(), message


def fed(path: Path, data: bytes, cuts: list[int], strict: bool = False) -> tuple[bytes, str]:
    """What a watch gives of bytes that come cut."""
    watched = Watched(path, strict)
    ends = [0, *sorted(cuts), len(data)]
    try:
        for start, end in pairwise(ends):
            watched.feed(data[start:end])
    except FileError as error:
        return watched.out.getvalue(), str(error)
    return watched.ended()
