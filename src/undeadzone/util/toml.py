"""Tables of scenarios, cures of mistakes in them, their text (fields with None are left out)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final

import msgspec
import numpy as np
import tomli_w

from undeadzone.errors import InputError
from undeadzone.util.files import read_table
from undeadzone.util.text import suggest_name

MOST_PARTS: Final = 64  # of a dotted key; tomllib takes time with the square of them
NEAR: Final = 0.65  # likeness from which on a name may be meant
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


def advise_on_name(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return the known name that is meant, the cure of a foreign word, or all known names.

    Args:
        name: unknown.
        known: the names.
        otherwise: words ahead of all names.
    """
    names = sorted(known)
    plain = dict(zip(map(_flatten, names), names, strict=True))
    flat = _flatten(name)
    words = read_table(__file__, "foreign_words.toml")
    meant = plain.get(words["methods"].get(flat, flat))
    if meant:
        return f"Did you mean {meant!r}?"
    advice = suggest_name(name, names, otherwise, NEAR)
    return advice if advice.startswith("Did") else words["keys"].get(name, advice)


def _flatten(name: str) -> str:
    """Return a name in small letters, without _, - and "filter"."""
    return re.sub("[_-]|filter", "", name.lower())


class _Named(msgspec.StructMeta):
    """Class of all tables, whose calls name the cure of a mistake."""

    def __call__(self, *values: Any, **options: Any) -> Any:
        """Return a table. Raises TypeError for an option that it does not have."""
        try:
            return super().__call__(*values, **options)
        except TypeError as error:
            known = self.__struct_fields__
            unknown = [name for name in options if name not in known]
            if not unknown and not values:
                raise
            advice = f"Write names, {self.__name__}({known[0]}=...)" if values else ""
            advice = advise_on_name(unknown[0], known, "Options:") if unknown else advice
            raise TypeError(f"{self.__name__}: {error}. {advice}") from None


class OptionTable(msgspec.Struct, metaclass=_Named, frozen=True, forbid_unknown_fields=True):
    """Table of a scenario."""


class Kind(OptionTable, frozen=True, tag_field="kind"):
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
