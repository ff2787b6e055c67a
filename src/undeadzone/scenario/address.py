"""Addresses: the key of a value in a scenario and, of an array, its entry, as `plant.A[1,0]`.

They are read here, and the numbers that they stand for are looked up and replaced.
"""

from __future__ import annotations

import difflib
import re
import typing
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Array, Floats

TUNABLE: Final = ("observer", "controller")  # the tables whose numbers have addresses


class Number(NamedTuple):
    """A number of the options.

    Attributes:
        value: in the scenario; None where it is left to the method.
        whole: whether it is a whole number.
    """

    value: float | None
    whole: bool


def stem(address: str) -> str:
    """An address without its index."""
    return address.partition("[")[0]


def index_of(address: str) -> str:
    """The index of an address with its brackets; empty if it has none."""
    return address[len(stem(address)) :]


def matching(address: str, names: Iterable[str]) -> list[str]:
    """The names that an address stands for.

    Without an index it stands for all entries, with `:` for all values of that index.
    """
    pattern = re.escape(stem(address)) + r"(\[.*\])?"
    if index := index_of(address):
        pattern = re.escape(stem(address) + index).replace(":", r"\d+")
    return [name for name in names if re.fullmatch(pattern, name)]


def entries_there(address: str, names: Iterable[str]) -> str:
    """The entries under the key of an address, first and last, in words; empty: there are none."""
    there = matching(stem(address), names)
    if there[1:]:
        return f"{there[0]} to {there[-1]}"
    return f"{there[0]} alone" if there else ""


def similar(address: str, names: Iterable[str], otherwise: str) -> str:
    """A question for the key that was meant, if one is similar; else what there is.

    Args:
        address: that no name has.
        names: those that there are.
        otherwise: words ahead of all their keys.
    """
    keys = sorted({stem(name) for name in names})
    near = difflib.get_close_matches(stem(address), keys, 1)
    return f"did you mean {near[0]!r}?" if near else f"{otherwise} {', '.join(keys)}"


def child(parent: Any, name: str) -> Any:
    """What stands under a name of a table or a struct; None where nothing does."""
    return parent.get(name) if isinstance(parent, Mapping) else getattr(parent, name, None)


def with_entry(key: str, present: Any, index: str, value: Any) -> Floats:
    """An array with another entry.

    Args:
        key: of the array, for messages.
        present: the array, or a list of numbers; None: there is none.
        index: of the entry, such as `1,0`.
        value: a number.

    Raises:
        InputError: no such entry, or no number.
    """
    place = tuple(map(int, index.split(",")))
    listed = ",".join(map(str, place))
    array = np.array(0.0 if present is None else present, float)
    if present is None or array.ndim != len(place):
        raise InputError(f"{key}: has no entry [{listed}]")
    try:
        array[place] = value
    except (IndexError, ValueError, TypeError):
        raise InputError(f"{key}[{listed}]: no such entry, or {value!r:.40} is no number") from None
    return array


def numbers(scenario: Any) -> dict[str, Number]:
    """Every number in the options of a scenario's observer and controller, by address."""
    found: dict[str, Number] = {}

    def walk(name: str, value: Any, kind: Any = None) -> None:
        """Take down what is below a value; kind: its annotation, where it has one."""
        if isinstance(value, msgspec.Struct):
            for field in msgspec.structs.fields(value):
                walk(f"{name}.{field.name}", getattr(value, field.name), field.type)
        elif isinstance(value, dict):
            for key, each in value.items():
                walk(f"{name}.{key}", each)
        elif isinstance(value, np.ndarray | list | tuple):
            for index, entry in np.ndenumerate(np.asarray(value, float)):
                place = f"[{','.join(map(str, index))}]" if index else ""
                found[name + place] = Number(float(entry), False)
        elif _may_be_number(value, kind):
            found[name] = Number(value, kind is int)

    for table in TUNABLE:
        walk(table, getattr(scenario, table))
    return found


def _may_be_number(value: Any, kind: Any) -> bool:
    """Whether a value is a number, or None where its annotation allows a number."""
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        return False
    return kind is None or bool({int, float, Array} & {kind, *typing.get_args(kind)})


def with_numbers(scenario: Any, values: Mapping[str, float]) -> Any:
    """The scenario with other numbers at addresses that `numbers` knows."""
    for address, value in values.items():
        scenario = _with_number(scenario, address, value)
    return scenario


def _with_number(parent: Any, address: str, value: float) -> Any:
    """A struct or dictionary with another number at an address in it."""
    head, _, rest = address.partition(".")
    name, index = stem(head), index_of(head)
    old = child(parent, name)
    new: Any = float(value)
    if rest:
        new = _with_number(old, rest, value)
    elif index:
        new = with_entry(name, old, index[1:-1], value)
    elif isinstance(old, int) and value == int(value):
        new = int(value)
    if isinstance(parent, dict):
        return parent | {name: new}
    return msgspec.structs.replace(parent, **{name: new})
