"""Texts that an export writes, as files of their own in which words are filled in."""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any, Final

_ASKED: Final = re.compile(r"^@\?([a-z_]+)@(.*\n)", re.MULTILINE)
_WORD: Final = re.compile("@([a-z_]+)@")


def text_of(path: str) -> str:
    """A file of this room.

    Args:
        path: as seen from here.
    """
    return files("undeadzone.exports").joinpath(path).read_text(encoding="utf-8")


def filled(path: str, words: dict[str, Any]) -> str:
    """A file of this room: each `@word@` is filled in, what begins with `@?word@` needs its truth.

    Args:
        path: as seen from here.
        words: what stands for each word, as text.
    """
    lines = _ASKED.sub(lambda line: line[2] if words[line[1]] else "", text_of(path))
    return _WORD.sub(lambda word: str(words[word[1]]), lines)


def called(name: str, tunable: bool) -> dict[str, Any]:
    """The words of texts that call an export.

    Args:
        name: what every symbol begins with.
        tunable: whether it has parameters.
    """
    return {"name": name, "tunable": tunable, "params": "&params, " if tunable else ""}
