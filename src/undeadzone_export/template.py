"""Templates of the texts that an export writes."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from undeadzone.util import text


def read_template(path: str) -> str:
    """Read a file of this package.

    Args:
        path: as seen from here.
    """
    return files("undeadzone_export").joinpath(path).read_text(encoding="utf-8")


def fill_template(path: str, words: dict[str, Any]) -> str:
    """Fill the words of a template file, as `util.text.fill_words` does.

    Args:
        path: as seen from here.
        words: text for each word.
    """
    return text.fill_words(read_template(path), words)


def call_words(name: str, tunable: bool) -> dict[str, Any]:
    """Return the template words of texts that call an export.

    Args:
        name: what every symbol begins with.
        tunable: whether it has parameters.
    """
    return {"name": name, "tunable": tunable, "params": "&params, " if tunable else ""}
