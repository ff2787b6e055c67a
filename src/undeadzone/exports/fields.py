"""What the structs of an export hold: names, sizes, units and meanings of the numbers of a step."""

from __future__ import annotations

import keyword
import re
import sys
from typing import Any, NamedTuple

import numpy as np

from undeadzone.interfaces import QUANTITIES, Estimate
from undeadzone.scenario.schema import Units
from undeadzone.support import tree

_RESERVED = """
auto break case char const continue default do double else enum extern float for goto if inline
int long register restrict return short signed sizeof static struct switch typedef union
unsigned void volatile while bool true false class new delete this and or not
"""
_HEADERS = """
arduino assert complex ctype errno fenv float inttypes iso646 limits locale main malloc math memory
pthread setjmp signal stdalign stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn
string strings tgmath threads time uchar unistd wchar wctype avr numpy
"""
_KEYWORDS = frozenset(_RESERVED.split())
# Words of C and Python, and files that one with such a name would hide.
_TAKEN = frozenset({*_KEYWORDS, *_HEADERS.split(), *keyword.kwlist, *sys.stdlib_module_names})


class Field(NamedTuple):
    """An array in a struct.

    Attributes:
        name: its name in C.
        size: how many numbers it holds.
        meaning: what they are, with their unit.
    """

    name: str
    size: int
    meaning: str


def identifier(text: str) -> str:
    """A name for files and symbols of any language, made of any text.

    It has letters, digits and single underscores in lower case; an n comes before what is a word of
    C or Python, a header of C or a module of Python, as math is.
    """
    name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_").lower()
    if not name:
        return "observer"
    return f"n{name}" if name[0].isdigit() or name in _TAKEN else name


def state_fields(state: Any, drop: str = "") -> list[Field]:
    """The fields of a state, named after its tree.

    Args:
        state: tree of NumPy arrays.
        drop: a prefix of the names in the tree to be left out.
    """
    fields: list[Field] = []
    for name, leaf in tree.leaves(state):
        size = int(np.size(leaf))
        if not size:
            continue
        short = name.removeprefix(drop).strip(".")
        base = _member(short) if short else "memory"
        fields.append(Field(_unused(base, fields), size, _state_meaning(short)))
    return fields


def _member(name: str) -> str:
    """The name of a field in C; capitals are kept, as W and w may differ."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return f"n{plain}" if plain[0].isdigit() or plain in _KEYWORDS else plain


def _unused(base: str, fields: list[Field]) -> str:
    """A name that no field has yet."""
    taken = {field.name for field in fields}
    name, count = base, 2
    while name in taken:
        name, count = f"{base}_{count}", count + 1
    return name


_MEANINGS = {
    "held": "the last finite input",
    "mean": "mean of the belief",
    "cov": "covariances of the belief, upper triangle column by column",
    "x": "estimated state",
    "right": "estimated right width",
    "left": "estimated left width",
    "W": "weights of the approximation",
}


def _state_meaning(name: str) -> str:
    """What is known of a part of the state by the end of its name."""
    return _MEANINGS.get(name.rsplit(".", 1)[-1], "memory of the method")


def estimate_meanings(units: Units) -> dict[str, str]:
    """What each field of an estimate means, with its unit."""
    states = units.state if isinstance(units.state, str) else ", ".join(units.state)
    names = {"output": units.output, "input": units.input}
    names |= {"state": states, "rate": f"({states})/s"}
    meanings = {}
    for name, quantity in QUANTITIES.items():
        unit = names.get(quantity.unit)
        meanings[name] = quantity.meaning if unit is None else f"{quantity.meaning} [{unit}]"
    return meanings


def estimate_fields(sizes: Estimate, units: Units) -> list[Field]:
    """The fields of an estimate that are not empty.

    Args:
        sizes: arrays of the sizes of its fields.
        units: names of the scenario's units.
    """
    meanings = estimate_meanings(units)
    fields: list[Field] = []
    for name, part in zip(Estimate._fields, sizes, strict=True):
        if np.size(part):
            fields.append(Field(name, int(np.size(part)), meanings[name]))
    return fields


def members(fields: list[Field]) -> list[tuple[str, int]]:
    """(name of the field, entry) of every number, in order."""
    places: list[tuple[str, int]] = []
    for field in fields:
        for entry in range(field.size):
            places.append((field.name, entry))
    return places
