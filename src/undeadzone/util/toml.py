"""Structs as TOML text, with exact numbers. Fields with value None are left out."""

from __future__ import annotations

import re
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w

from undeadzone.errors import InputError

MOST_PARTS: Final = 64  # of a dotted key; tomllib takes time with the square of them
_PART: Final = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+"""
_LONG_KEY: Final = re.compile(rf"(?<![\w-])(?:{_PART}){{{MOST_PARTS}}}")


def require_short_keys(text: str) -> str:
    """Return a TOML text as it is. Raises InputError for a key of very many parts.

    Args:
        text: not parsed yet.
    """
    found = _LONG_KEY.search(text)
    if found is None:
        return text
    line = text.count("\n", 0, found.start()) + 1
    raise InputError(
        f"line {line}: a dotted key of more than {MOST_PARTS} parts: {found[0]:.20}.... No "
        "scenario has such a key"
    )


class Kind(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind"):
    """Table of a scenario with several kinds, chosen by the key `kind`."""


def to_toml(value: msgspec.Struct) -> str:
    """Return the TOML text of a struct.

    Raises:
        InputError: something in it that no text can hold.
    """
    return tomli_w.dumps(to_tables(value))


def to_tables(value: msgspec.Struct) -> dict[str, Any]:
    """Return a struct as dictionaries, lists and numbers with its tag. Fields with value None are
    left out.

    Raises:
        InputError: something in it that no text can hold.
    """
    return dict(_drop_none(msgspec.to_builtins(value, enc_hook=_to_python_value)))


def _to_python_value(value: Any) -> Any:
    """Return NumPy numbers and arrays as numbers and lists of Python."""
    if isinstance(value, np.ndarray | np.number):
        return value.tolist()
    raise InputError(f"{value!r:.60} cannot be written as TOML. Give formulas as text")


def _drop_none(value: Any) -> Any:
    """Return a tree of dictionaries and lists without the keys with value None."""
    if isinstance(value, dict):
        return {key: _drop_none(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return list(map(_drop_none, value))
    return value
