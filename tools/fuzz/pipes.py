"""Commands between pipes that wait, do not block, are slow, full or closed.

What comes out is what a plain run gives, or the command says that it failed; nothing is cut.
"""

from __future__ import annotations

import functools
import itertools
import os
import random
import select
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

from tests.live import KALMAN, line, regular
from tests.traps import COMMAND, SHORT

from tools.fuzz.case import Case

FILES: Final = {"lever.toml": KALMAN.encode(), "s.toml": SHORT.encode()}
COMMANDS: Final = (
    *[["watch", "lever.toml"]] * 5,
    ["watch", "lever.toml", "--json"],
    ["run", "s.toml", "--no-figures"],
    ["check", "s.toml", "--no-figures"],
    ["--help"],
)
LONGEST: Final = 90.0  # [s] of a command
PIECE: Final = 1 << 16


class Pipes(NamedTuple):
    """How a command is connected.

    Attributes:
        blocking: whether stdin, stdout and stderr block.
        pieces: where the input is cut.
        pauses: after which of the pieces the feeder sleeps.
        slow: how long the reader sleeps before it reads, and how much it reads at once.
        out: a pipe, one that is closed after so many bytes, or a full device.
    """

    blocking: tuple[bool, bool, bool]
    pieces: tuple[int, ...]
    pauses: frozenset[int]
    slow: tuple[float, int]
    out: str | int


def case(draw: random.Random) -> Case:
    """A command, and how it is connected."""
    command = draw.choice(COMMANDS)
    count = draw.choice((0, 1, 30, 400, 3000)) if command[0] == "watch" else 0
    data = b"t,y,u\n" + b"".join(map(line, regular(count))) if count else b""
    cuts = sorted(draw.randrange(len(data) + 1) for _ in range(draw.choice((0, 1, 5, 40))))
    pauses = frozenset(draw.sample(range(len(cuts) + 1), min(len(cuts), draw.choice((0, 1, 3)))))
    blocking = (draw.random() < 0.3, draw.random() < 0.3, draw.random() < 0.3)
    out = draw.choice((*["pipe"] * 5, draw.choice((0, 1, 500, 70_000)), "full"))
    slow = draw.choice(((0.0, PIECE), (1.5, PIECE), (0.0, 100), (1.5, 4096)))
    how = Pipes(blocking, tuple(cuts), pauses, slow, out)
    kind = f"{command[0]}, {'closed' if isinstance(out, int) else out}"
    return Case(kind, FILES, call=functools.partial(_the_same, command, data, how))


def _the_same(command: list[str], data: bytes, how: Pipes, folder: Path) -> None:
    """Run a command plainly and through the pipes; compare."""
    plain = subprocess.run([*COMMAND, *command], input=data, capture_output=True, timeout=LONGEST)
    code, out, err = _piped(command, data, how)
    if how.out == "full" and plain.stdout:
        assert (code, err.count(b"\n")) == (2, 1), f"a full device: exit {code}, {err!r:.200}"
        assert err.startswith(b"undeadzone: stdout: cannot write"), f"{err!r:.200}"
        return
    if isinstance(how.out, int):
        assert code in (0, plain.returncode), f"a closed pipe: exit {code}, {err!r:.200}"
        assert b"Traceback" not in err, f"{err!r:.200}"
        assert plain.stdout.startswith(out), "what came before the end is something else"
        return
    assert code == plain.returncode, f"exit {code} for {plain.returncode}: {err!r:.200}"
    if how.out != "full":
        assert out == plain.stdout, f"{len(out)} bytes of {len(plain.stdout)} came out"
    assert err == plain.stderr, f"stderr {err!r:.200} for {plain.stderr!r:.200}"


def _piped(command: list[str], data: bytes, how: Pipes) -> tuple[int, bytes, bytes]:
    """Exit code, stdout and stderr of a command between these pipes."""
    source, feed = os.pipe()
    drain, sink = os.pipe()
    read_err, write_err = os.pipe()
    full = os.open("/dev/full", os.O_WRONLY)
    for descriptor, blocks in zip((source, sink, write_err), how.blocking, strict=True):
        os.set_blocking(descriptor, blocks)
    out = full if how.out == "full" else sink
    with subprocess.Popen(
        [*COMMAND, *command], stdin=source, stdout=out, stderr=write_err
    ) as running:
        for descriptor in (source, sink, full, write_err):
            os.close(descriptor)
        for descriptor in (feed, drain, read_err):
            os.set_blocking(descriptor, False)
        texts = _moved(feed, drain, read_err, data, how)
        with suppress(subprocess.TimeoutExpired):
            running.wait(LONGEST)
        running.kill()
    return running.returncode, texts[drain], texts[read_err]


def _moved(feed: int, drain: int, said: int, data: bytes, how: Pipes) -> Mapping[int, bytes]:
    """Feed the input, and return what came out of each pipe."""
    ends = (0, *how.pieces, len(data))
    parts = [data[a:b] for a, b in itertools.pairwise(ends)]
    texts = {drain: b"", said: b""}
    open_ends, part, rest = {feed, drain, said}, 0, parts[0]
    begin_reading = time.monotonic() + how.slow[0]
    until = time.monotonic() + LONGEST
    feed_again = 0.0
    while open_ends - {feed} and time.monotonic() < until:
        now = time.monotonic()
        wanted = {end for end in open_ends - {feed} if end == said or now >= begin_reading}
        fed = {feed} & open_ends if now >= feed_again else set()
        readable, writable, _ = select.select(wanted, fed, [], 0.05)
        for end in readable:
            piece = os.read(end, how.slow[1] if end == drain else PIECE)
            texts[end] += piece
            is_closed = end == drain and isinstance(how.out, int) and len(texts[end]) >= how.out
            if not piece or is_closed:
                os.close(end)
                open_ends.discard(end)
        if writable:
            try:
                rest = rest[os.write(feed, rest) :]
            except BrokenPipeError:
                part, rest = len(parts) - 1, b""
            if not rest:
                if part in how.pauses:
                    feed_again = now + 0.4
                part += 1
                if part >= len(parts):
                    os.close(feed)
                    open_ends.discard(feed)
                else:
                    rest = parts[part]
    for end in open_ends:
        os.close(end)
    return texts
