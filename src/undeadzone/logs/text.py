"""Bytes as they come in, cut into lines of text."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from undeadzone.errors import FileError, InputError
from undeadzone.support.files import LARGEST_RUN, reason, require_plain

BLOCK: Final = 1 << 22  # bytes of a file that are read at once
LONGEST: Final = 65_536  # characters of a line; a longer one is no line of numbers
_MARKS: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def blocks_of(path: Path, largest: int = LARGEST_RUN) -> Iterator[tuple[bytes, bool]]:
    """The bytes of a file in blocks, each with whether it is the last. Raises FileError.

    Args:
        path: of the file.
        largest: size [bytes] beyond which it is refused.
    """
    try:
        require_plain(path, largest)
        with open(path, "rb") as file:
            while True:
                data = file.read(BLOCK)
                yield data, not data
                if not data:
                    return
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise FileError(f"{path}: cannot read: {reason(error)}") from None


class Text:
    """Bytes in, whole lines out: UTF-8, UTF-16 with its mark, else Windows' Western European.

    Args:
        source: where the bytes come from, for messages.
    """

    def __init__(self, source: str) -> None:
        self._source = source
        self._decoder: codecs.IncrementalDecoder | None = None
        self._rest = ""  # a line that has begun

    def feed(self, data: bytes, last: bool = False) -> list[str]:
        """The lines that are whole now, without their ends.

        Args:
            data: the bytes that came in; the first call has two at least, if there are two.
            last: whether no more will come; then the line that has begun is whole.

        Raises:
            FileError: this is no text.
        """
        text = self._rest + self._decoded(data, last)
        if "\0" in text:
            raise FileError(f"{self._source}: not CSV text (it holds bytes of 0)")
        if last:
            text += "\n"
        held_back = "\r" if text.endswith("\r") else ""
        text = text.removesuffix("\r").replace("\r\n", "\n").replace("\r", "\n")
        *lines, rest = text.split("\n")
        self._rest = rest + held_back
        if max(map(len, (rest, *lines))) > LONGEST:
            self._refuse_long((rest, *lines))
        return lines

    def _refuse_long(self, lines: tuple[str, ...]) -> None:
        """Raise FileError for a long line that is no remark."""
        for line in lines:
            if len(line) > LONGEST and not line.startswith(("#", "%", "//")):
                raise FileError(
                    f"{self._source}: not CSV text (a line of more than {LONGEST} characters)"
                )

    def _decoded(self, data: bytes, last: bool) -> str:
        """The text of the bytes that came in."""
        if self._decoder is None:
            encoding = "utf-16" if data[:2] in _MARKS else "utf-8-sig"
            self._decoder = codecs.getincrementaldecoder(encoding)()
        try:
            return self._decoder.decode(data, last)
        except UnicodeDecodeError:
            self._decoder = codecs.getincrementaldecoder("cp1252")("replace")
            return self._decoder.decode(data, last)
