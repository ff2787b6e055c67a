"""The numbers in the options of observer and controller, by address, and how to replace them."""

from __future__ import annotations

import difflib
import re
import typing
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.ensemble.addresses import index_of, matching, stem
from undeadzone.errors import InputError
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import TABLE, Range
from undeadzone.support.arrays import LARGEST, Array, Floats

PARTS: Final = ("observer", "controller")


class Number(NamedTuple):
    """A number of the options.

    Attributes:
        value: in the scenario; None where it is left to the method
        whole: whether it is a whole number
    """

    value: float | None
    whole: bool


class Parameter(NamedTuple):
    """A number that is tuned.

    Attributes:
        name: its address
        low, high: the bounds of its range
        log: whether shares of the range are counted on a logarithmic scale
        whole: whether it is a whole number
        start: where the search begins
    """

    name: str
    low: float
    high: float
    log: bool
    whole: bool
    start: float

    def value(self, u: Floats) -> Floats:
        """The number at the share u, 0 to 1, of the range."""
        if self.log:
            value = self.low * (self.high / self.low) ** u
        else:
            value = self.low + u * (self.high - self.low)
        if self.whole:
            value = np.round(value)
        return np.clip(value, self.low, self.high)

    def share(self, value: float) -> float:
        """The share of the range at which a number lies."""
        if self.log:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


def numbers(scenario: Scenario) -> dict[str, Number]:
    """Every number of the options, by address."""
    by_address: dict[str, Number] = {}
    for part in PARTS:
        by_address |= _numbers(part, getattr(scenario, part))
    return by_address


def with_numbers(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """The scenario with other numbers at addresses that `numbers` knows."""
    for address, value in values.items():
        scenario = _with(scenario, address.split("."), value)
    return scenario


def named(address: str, known: Mapping[str, Number]) -> list[str]:
    """The numbers that an address stands for.

    A list may be indexed as the column that it is, one number as a list.

    Args:
        address: such as `observer.L` or `observer.L[:,0]`
        known: the numbers of the options, by address

    Raises:
        InputError
    """
    as_list = re.sub(r",[0:]\]$", "]", address)
    as_number = re.sub(r"\[[0:](,[0:])?\]$", "", address)
    for form in (address, as_list, as_number):
        if names := matching(form, known):
            return names
    raise InputError(f"{TABLE.entry_name(address)}: {_why_unknown(stem(address), known)}")


def _why_unknown(key: str, known: Mapping[str, Number]) -> str:
    """Why no number has an address, and what to do; key: the address without its index."""
    there = [name for name in known if stem(name) == key]
    if there and known[there[0]].value is None:
        return (
            f"the scenario gives no {key}; write it there, entry by entry, or name another number"
        )
    if there:
        extent = f"{there[0]} to {there[-1]}" if there[1:] else f"{there[0]} alone"
        return f"no such entry; there is {extent}"
    stems = sorted({stem(name) for name in known})
    near = difflib.get_close_matches(key, stems, 1)
    choice = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(stems)}"
    return f"no number of that name in the options; {choice}"


def parameters(entries: Mapping[str, Range], scenario: Scenario) -> tuple[Parameter, ...]:
    """What is tuned.

    Args:
        entries: of the table [tune]: ranges by address
        scenario: whose options hold the numbers

    Raises:
        InputError: for no entry, an address that is not there or there twice, bounds that cannot be
    """
    if not entries:
        raise InputError(
            "tune: nothing to tune; name a number and its bounds in a table [tune]: "
            f"{TABLE.example}"
        )
    known = numbers(scenario)
    tuned: list[Parameter] = []
    for address, bounds in entries.items():
        for name in named(address, known):
            tuned.append(_parameter(address, name, bounds, known[name]))
    names = [parameter.name for parameter in tuned]
    for name in names:
        if names.count(name) > 1:
            place = TABLE.entry_name(name)
            raise InputError(f"{place}: tuned twice; keep one entry that names it")
    return tuple(tuned)


def _numbers(name: str, value: Any, kind: Any = None) -> dict[str, Number]:
    """The numbers below a value of the options, by address.

    Args:
        name: address of the value
        value: a number, a list of numbers, or a table
        kind: its annotation, where it has one
    """
    below: dict[str, Number] = {}
    if isinstance(value, msgspec.Struct):
        for field in msgspec.structs.fields(value):
            child = getattr(value, field.name)
            below |= _numbers(f"{name}.{field.name}", child, field.type)
    elif isinstance(value, dict):
        for key, child in value.items():
            below |= _numbers(f"{name}.{key}", child)
    elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        if kind is None or {int, float, Array} & {kind, *typing.get_args(kind)}:
            below[name] = Number(value, kind is int)
    elif isinstance(value, np.ndarray | list | tuple):
        below.update(_numbers_of_array(name, np.asarray(value, float)))
    return below


def _numbers_of_array(name: str, array: Floats) -> Iterator[tuple[str, Number]]:
    """(address, number) of each entry of an array."""
    for index in np.ndindex(array.shape):
        place = f"[{','.join(map(str, index))}]" if index else ""
        yield name + place, Number(float(array[index]), False)


def _with(node: Any, path: list[str], value: float) -> Any:
    """A struct or dictionary with a number in place of the one at the end of a path."""
    name = stem(path[0])
    old = node[name] if isinstance(node, dict) else getattr(node, name)
    if path[1:]:
        new = _with(old, path[1:], value)
    else:
        new = _replaced(old, index_of(path[0]), value)
    if isinstance(node, dict):
        return node | {name: new}
    return msgspec.structs.replace(node, **{name: new})


def _replaced(old: Any, index: str, value: float) -> Any:
    """An option with another number: in place of the entry `[i]` or `[i,j]`, or of all of it."""
    if index:
        array = np.array(old, float)
        array[tuple(map(int, index[1:-1].split(",")))] = value
        return array
    whole = isinstance(old, int) and not isinstance(old, bool)
    if whole and value == int(value):
        return int(value)
    return float(value)


def _parameter(address: str, name: str, bounds: Range, number: Number) -> Parameter:
    """A number with its checked bounds and its start; address: of its entry. Raises InputError."""
    place = TABLE.entry_name(address)
    low, high = bounds.between
    if not -LARGEST <= low < high <= LARGEST:
        raise InputError(
            f"{place}.between: expected [low, high] with low < high, found [{low:g}, {high:g}]"
        )
    if bounds.log and low <= 0:
        raise InputError(
            f"{place}.between: a logarithmic scale needs positive bounds, found {low:g}; "
            "leave out log or raise it"
        )
    start, whose, advice = bounds.start, "start", "widen between"
    if start is None:
        start, whose, advice = number.value, f"the scenario's {name}", f"{advice}, or give start"
    if start is None:
        start = float(np.sqrt(low * high) if bounds.log else (low + high) / 2)
    if not low <= start <= high:
        raise InputError(f"{place}: {whose} = {start:g} lies outside [{low:g}, {high:g}]; {advice}")
    if number.whole:
        start = float(np.round(start))
    return Parameter(name, low, high, bounds.log, number.whole, float(start))
