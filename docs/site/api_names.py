"""Extension of the API page: an entry of several names becomes an entry of each."""

from __future__ import annotations

import re
from typing import Any

import griffe

ENTRY = re.compile(r"(?m)^( +)(\w+(?:, \w+)+): (.*(?:\n\1 +.*)*)$")


class SplitNames(griffe.Extension):
    """Docstrings in which `A, B: text` stands once for each name."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Split the entries of an object's docstring."""
        if obj.docstring is not None:
            obj.docstring.value = ENTRY.sub(split_entry, obj.docstring.value)


def split_entry(match: re.Match[str]) -> str:
    """Return an entry of each name, with the same text."""
    indent, names, text = match.groups()
    return "\n".join(f"{indent}{name}: {text}" for name in names.split(", "))
