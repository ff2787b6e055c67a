"""Standard streams that wait: a descriptor that would block loses no byte and is no end of
input.
"""

from __future__ import annotations

import io
import os
import select
import sys
from contextlib import suppress
from typing import Any, Final

STREAMS: Final = {"stdin": "rb", "stdout": "wb", "stderr": "wb"}


class WaitingFile(io.FileIO):
    """File of a descriptor whose reads and writes wait until they are possible.

    Whoever shares a descriptor (a service manager, an event loop) may make it non-blocking at any
    time. `io.FileIO` then returns None, which buffers above take for a failure or for an end.
    """

    def write(self, data: Any, /) -> int:
        """Write bytes, as many as fit, and return how many; wait if none fit."""
        written: int | None = None
        while written is None:
            written = super().write(data)
            if written is None:
                select.select([], [self.fileno()], [])
        return written

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes into a buffer and return how many; wait if none are there, 0 at the end."""
        count: int | None = None
        while count is None:
            count = super().readinto(buffer)
            if count is None:
                select.select([self.fileno()], [], [])
        return count

    def readall(self) -> bytes:
        """Return all bytes up to the end."""
        parts = bytearray()
        block = bytearray(io.DEFAULT_BUFFER_SIZE)
        while count := self.readinto(block):
            parts += block[:count]
        return bytes(parts)


def wait_for_streams() -> None:
    """Let the standard streams of this process wait (POSIX); streams without descriptor stay."""
    if os.name != "posix":
        return
    for name, mode in STREAMS.items():
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper):
            with suppress(OSError, ValueError):  # closed, or without a descriptor
                setattr(sys, name, _with_waiting_file(stream, mode))


def _with_waiting_file(stream: io.TextIOWrapper, mode: str) -> io.TextIOWrapper:
    """Return a stream like another one, on a `WaitingFile` of its descriptor.

    Raises:
        OSError, ValueError: it has no open descriptor.
    """
    stream.flush()
    file = WaitingFile(stream.fileno(), mode, closefd=False)
    buffered: Any = io.BufferedReader(file) if mode == "rb" else io.BufferedWriter(file)
    return io.TextIOWrapper(
        buffered,
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
