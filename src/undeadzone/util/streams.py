"""Standard streams that wait: a non-blocking descriptor loses no byte and does not end the
input.
"""

from __future__ import annotations

import io
import select
import sys
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer


class WaitingFile(io.FileIO):
    """File of a descriptor whose reads and writes wait until they are possible."""

    def write(self, data: ReadableBuffer, /) -> int:
        """Write as many bytes as fit, wait if none fit, and return the number.

        Args:
            data: bytes.
        """
        while True:
            count: int | None = super().write(data)
            if count is not None:
                return count
            select.select([], [self], [])

    def readinto(self, room: WriteableBuffer, /) -> int:
        """Read bytes into a buffer, wait for the first byte, and return the number (0 at the end).

        Args:
            room: buffer that they go to.
        """
        while True:
            count: int | None = super().readinto(room)
            if count is not None:
                return count
            select.select([self], [], [])


def let_streams_wait() -> None:
    """Put streams that wait in the place of stdin, stdout and stderr, where these are descriptors.

    A stream that a caller has replaced stays, as does every stream on Windows, as all streams block
    there.
    """
    if sys.platform == "win32":
        return
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        stream = getattr(sys, name)
        if _is_descriptor(stream, number):
            setattr(sys, name, _waiting(stream, number))


def _is_descriptor(stream: Any, number: int) -> bool:
    """Return whether a stream is what Python opened on a standard descriptor."""
    if not isinstance(stream, io.TextIOWrapper):
        return False
    raw = getattr(stream.buffer, "raw", stream.buffer)
    return type(raw) is io.FileIO and raw.fileno() == number


def _waiting(stream: io.TextIOWrapper, number: int) -> TextIO:
    """Return a stream that waits, otherwise as another one."""
    raw = WaitingFile(number, "w" if number else "r", closefd=False)
    if number:
        stream.flush()
    buffer: Any = io.BufferedWriter(raw) if number else io.BufferedReader(raw)
    return io.TextIOWrapper(
        buffer,
        stream.encoding,
        stream.errors,
        line_buffering=stream.line_buffering,
        write_through=bool(number) and stream.write_through,
    )
