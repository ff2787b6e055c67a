"""The numbers in the options of observer and controller, by address, and scenarios with others in their place."""

from __future__ import annotations

import difflib
import re
import typing
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.ensemble.addresses import matching, stem
from undeadzone.errors import InputError
from undeadzone.scenario.schema import Scenario
from undeadzone.scenario.tune_table import TABLE, Range
from undeadzone.support.arrays import LARGEST, Array, Floats

PARTS: Final = ("observer", "controller")


class Number(NamedTuple):
    """A number of the options: its value, None where it is left to the method; whether it is a whole number."""

    value: float | None
    whole: bool


class Parameter(NamedTuple):
    """A number that is tuned, from `start` on, between low and high."""

    name: str
    low: float
    high: float
    log: bool
    whole: bool
    start: float

    def value(self, u: Floats) -> Floats:
        """The number at the share u, 0 to 1, of the range."""
        found = (
            self.low * (self.high / self.low) ** u
            if self.log
            else self.low + u * (self.high - self.low)
        )
        return np.clip(np.round(found) if self.whole else found, self.low, self.high)

    def share(self, value: float) -> float:
        """The share of the range at which a number lies."""
        if self.log:
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return (value - self.low) / (self.high - self.low)


def numbers(scenario: Scenario) -> dict[str, Number]:
    """Every number of the options, by address."""
    return {
        name: number for part in PARTS for name, number in _numbers(part, getattr(scenario, part))
    }


def with_numbers(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """The scenario with other numbers at addresses that `numbers` knows."""
    for address, value in values.items():
        scenario = _with(scenario, address.split("."), value)
    return scenario


def named(address: str, known: Mapping[str, Number]) -> list[str]:
    """The numbers that an address stands for; a list may be indexed as the column that it is, one number as a list. Raises InputError."""
    for form in (
        address,
        re.sub(r",[0:]\]$", "]", address),
        re.sub(r"\[[0:](,[0:])?\]$", "", address),
    ):
        if names := matching(form, known):
            return names
    key, place = stem(address), TABLE.entry_name(address)
    there = [name for name in known if stem(name) == key]
    if there and known[there[0]].value is None:
        raise InputError(
            f"{place}: the scenario gives no {key}; write it there, entry by entry, or name another number"
        )
    if there:
        raise InputError(
            f"{place}: no such entry; there is {there[0]}{f' to {there[-1]}' if there[1:] else ' alone'}"
        )
    stems = sorted({stem(name) for name in known})
    near = difflib.get_close_matches(key, stems, 1)
    raise InputError(
        f"{place}: no number of that name in the options; {f'did you mean {near[0]!r}?' if near else 'there are ' + ', '.join(stems)}"
    )


def parameters(entries: Mapping[str, Range], scenario: Scenario) -> tuple[Parameter, ...]:
    """What is tuned. Raises InputError: nothing, an address that is not there or there twice, bounds that cannot be."""
    if not entries:
        raise InputError(
            f"tune: nothing to tune; name a number and its bounds in a table [tune]: {TABLE.example}"
        )
    known = numbers(scenario)
    found = [
        _parameter(address, name, given, known[name])
        for address, given in entries.items()
        for name in named(address, known)
    ]
    names = [parameter.name for parameter in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{TABLE.entry_name(twice[0])}: tuned twice; keep one entry that names it")
    return tuple(found)


def _numbers(name: str, value: Any, kind: Any = None) -> Iterator[tuple[str, Number]]:
    """The numbers below a value whose annotation is `kind`."""
    if isinstance(value, msgspec.Struct):
        for field in msgspec.structs.fields(value):
            yield from _numbers(f"{name}.{field.name}", getattr(value, field.name), field.type)
    elif isinstance(value, dict):
        for key, child in value.items():
            yield from _numbers(f"{name}.{key}", child)
    elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
        if kind is None or {int, float, Array} & {kind, *typing.get_args(kind)}:
            yield name, Number(value, kind is int)
    elif isinstance(value, np.ndarray | list | tuple):
        array = np.asarray(value, float)
        for index in np.ndindex(array.shape):
            yield (
                name + (f"[{','.join(map(str, index))}]" if index else ""),
                Number(float(array[index]), False),
            )


def _with(node: Any, path: list[str], value: float) -> Any:
    """A struct or dictionary with a number in place of the one at the end of a path."""
    name = stem(path[0])
    old = node[name] if isinstance(node, dict) else getattr(node, name)
    if path[1:]:
        new = _with(old, path[1:], value)
    elif index := path[0][len(name) :]:
        new = np.array(old, float)
        new[tuple(map(int, index[1:-1].split(",")))] = value
    else:
        new = (
            int(value)
            if isinstance(old, int) and not isinstance(old, bool) and value == int(value)
            else float(value)
        )
    return (
        node | {name: new}
        if isinstance(node, dict)
        else msgspec.structs.replace(node, **{name: new})
    )


def _parameter(address: str, name: str, given: Range, number: Number) -> Parameter:
    place, (low, high) = TABLE.entry_name(address), given.between
    if not -LARGEST <= low < high <= LARGEST:
        raise InputError(
            f"{place}.between: expected [low, high] with low < high, found [{low:g}, {high:g}]"
        )
    if given.log and low <= 0:
        raise InputError(
            f"{place}.between: a logarithmic scale needs positive bounds, found {low:g}; leave out log or raise it"
        )
    start, whose = (
        (number.value, f"the scenario's {name}") if given.start is None else (given.start, "start")
    )
    if start is None:
        start = float(np.sqrt(low * high) if given.log else (low + high) / 2)
    if not low <= start <= high:
        raise InputError(
            f"{place}: {whose} = {start:g} lies outside [{low:g}, {high:g}]; widen between{', or give start' * (given.start is None)}"
        )
    return Parameter(
        name, low, high, given.log, number.whole, float(np.round(start) if number.whole else start)
    )
