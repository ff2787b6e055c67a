"""Texts that an export writes, as files of their own in which words are filled in."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from undeadzone.util import text


def text_of(path: str) -> str:
    """Return a file of this room.

    Args:
        path: as seen from here.
    """
    return files("undeadzone_export").joinpath(path).read_text(encoding="utf-8")


def fill_template(path: str, words: dict[str, Any]) -> str:
    """Return a file of this room with its words filled in, as `support.text.filled` does.

    Args:
        path: as seen from here.
        words: what stands for each word, as text.
    """
    return text.fill_words(text_of(path), words)


def call_words(name: str, tunable: bool) -> dict[str, Any]:
    """Return the words of texts that call an export.

    Args:
        name: what every symbol begins with.
        tunable: whether it has parameters.
    """
    return {"name": name, "tunable": tunable, "params": "&params, " if tunable else ""}
