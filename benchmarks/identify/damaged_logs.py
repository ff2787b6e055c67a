"""Thousands of damaged CSV logs: each is read, or refused in words; nothing else may happen."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.markdown import head, row
from undeadzone.errors import UndeadzoneError
from undeadzone.logs.samples import LogReader
from undeadzone_identify.logs.grid import to_grid
from undeadzone_identify.logs.log import read_log

FILES = 10_000


def damaged(rng: np.random.Generator, text: str) -> bytes:
    """A log with a few random wounds."""
    data = bytearray(text.encode())
    for _ in range(rng.integers(1, 6)):
        place = int(rng.integers(0, len(data)))
        match rng.integers(0, 6):
            case 0:
                data[place] = int(rng.integers(0, 256))
            case 1:
                del data[place : place + int(rng.integers(1, 40))]
            case 2:
                data[place:place] = rng.choice([b",", b";", b"\n", b"nan", b"1e400", b'"', b"\t"])
            case 3:
                data[place:place] = data[place : place + 30]
            case 4:
                del data[place:]
            case _:
                data[place:place] = rng.bytes(3)
        if not data:
            break
    return bytes(data)


def undamaged(rng: np.random.Generator) -> str:
    """A log of 40 samples in one of several dialects."""
    table = np.column_stack([0.1 * np.arange(40), rng.standard_normal((40, 2)).round(3)])
    separator = str(rng.choice([",", ";", "\t", " "]))
    lines = [separator.join(["t [s]", "u [V]", "y [V]"])]
    if separator == " ":
        lines = ["t u y"]
    lines += [separator.join(f"{number:g}" for number in line) for line in table]
    return "\n".join(lines) + "\n"


def counted(files: int, path: Path) -> dict[str, int]:
    """What became of damaged logs.

    Args:
        files: how many.
        path: where each is written in turn.
    """
    rng = np.random.default_rng(0)
    counts = dict.fromkeys(("read by identify", "refused by identify"), 0)
    counts |= dict.fromkeys(("read by watch", "refused by watch"), 0)
    for _ in range(files):
        data = damaged(rng, undamaged(rng))
        path.write_bytes(data)
        counts[identified(path)] += 1
        counts[watched(data)] += 1
    return counts


def identified(path: Path) -> str:
    """Whether `identify` takes a log."""
    try:
        to_grid([read_log(path)])
    except UndeadzoneError:
        return "refused by identify"
    return "read by identify"


def watched(data: bytes) -> str:
    """Whether `watch` takes a log, in pieces."""
    reader = LogReader("stdin", 1, 1, {})
    try:
        for start in range(0, len(data), 97):
            reader.feed(data[start : start + 97])
        reader.feed(b"", last=True)
    except UndeadzoneError:
        return "refused by watch"
    return "read by watch"


def table() -> str:
    """The section of RESULTS.md."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        counts = counted(FILES, Path(folder) / "log.csv")
    spent = 1e3 * (time.perf_counter() - began) / FILES
    lines = [
        "## Damaged logs",
        "",
        f"{FILES} CSV logs with one to five random wounds each, {spent:.1f} ms a log. Anything but"
        " a log or a message in words would end this benchmark.",
        "",
        *head("what became of them", "logs"),
        *[row(name, str(count)) for name, count in counts.items()],
        "",
    ]
    return "\n".join(lines)
