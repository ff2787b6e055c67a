"""Addresses: the key of a value in a scenario and, of an array, its entry, as `plant.A[1,0]`.

They are read here, and the values that they stand for are looked up and replaced: numbers of the
options one by one, anything else with the checks that a file's words meet.
"""

from __future__ import annotations

import difflib
import functools
import math
import re
import typing
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, TypeVar

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.registry import decode_field
from undeadzone.scenario import ensemble_table, tune_table
from undeadzone.scenario.messages import CHOOSERS, explain
from undeadzone.util.arrays import Array, Floats
from undeadzone.util.toml import advise_on_name, to_tables

TUNABLE: Final = ("observer", "controller")  # the tables whose numbers have addresses
TABLES: Final = (ensemble_table.TABLE, tune_table.TABLE)  # those whose keys may be addresses
S = TypeVar("S", bound=msgspec.Struct)
LAST = "compare"  # changed after [observer], whose keys it may take
# keys whose numbers may be infinite
ENDLESS: Final = ("sensor.range", "sensor.right", "sensor.left")


class Number(NamedTuple):
    """A number of the options.

    Attributes:
        value: in the scenario (None if it is left to the method).
        whole: whether it is a whole number.
    """

    value: float | None
    whole: bool


def stem(address: str) -> str:
    """Return an address without its index."""
    return address.partition("[")[0]


def index_of(address: str) -> str:
    """Return the index of an address with its brackets, empty if it has none."""
    return address[len(stem(address)) :]


def matching(address: str, names: Iterable[str]) -> list[str]:
    """Return the names that an address stands for.

    Without an index it stands for all entries, with `:` for all values of that index.
    """
    pattern = re.escape(stem(address)) + r"(\[.*\])?"
    if index := index_of(address):
        pattern = re.escape(stem(address) + index).replace(":", r"\d+")
    return [name for name in names if re.fullmatch(pattern, name)]


def entries_there(address: str, names: Iterable[str]) -> str:
    """Return the entries under the key of an address, first and last, in words (empty: there are
    none).
    """
    there = matching(stem(address), names)
    if there[1:]:
        return f"{there[0]} to {there[-1]}"
    return f"{there[0]} alone" if there else ""


def similar(address: str, names: Iterable[str], otherwise: str) -> str:
    """Return a question for the key that was meant, if one is similar, else the existing keys.

    Args:
        address: that no name has.
        names: those that there are.
        otherwise: words ahead of all their keys.
    """
    keys = sorted(set(map(stem, names)))
    return advise_on_name(stem(address), keys, otherwise)


def child(parent: Any, name: str) -> Any:
    """Return the value under a name of a table or a struct, or None if it has no such entry."""
    return parent.get(name) if isinstance(parent, Mapping) else getattr(parent, name, None)


def with_entry(key: str, present: Any, index: str, value: Any) -> Floats:
    """Return an array with another entry.

    Args:
        key: of the array, for messages.
        present: the array, or a list of numbers (None: there is none).
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
        raise InputError(
            f"{key}[{listed}]: no such entry, or {value!r:.40} is not a number"
        ) from None
    return array


def find_option_numbers(scenario: Any, tables: Iterable[str] = TUNABLE) -> dict[str, Number]:
    """Return every number in tables of a scenario, by address.

    Args:
        scenario: the scenario.
        tables: names of its tables (default: the options of observer and controller).
    """
    found: dict[str, Number] = {}

    def walk(name: str, value: Any, kind: Any = None) -> None:
        """Record the numbers below a value (kind: its annotation, if any)."""
        if isinstance(value, msgspec.Struct):
            for field in msgspec.structs.fields(value):
                walk(f"{name}.{field.name}", getattr(value, field.name), field.type)
        elif isinstance(value, dict):
            for key, each in value.items():
                walk(f"{name}.{key}", each)
        elif isinstance(value, np.ndarray | list | tuple):
            if not _are_numbers(value):
                return
            for index, entry in np.ndenumerate(np.asarray(value, float)):
                place = f"[{','.join(map(str, index))}]" if index else ""
                found[name + place] = Number(float(entry), False)
        elif _may_be_number(value, kind):
            found[name] = Number(value, kind is int)

    for table in tables:
        walk(table, getattr(scenario, table))
    return found


def _are_numbers(values: Any) -> bool:
    """Return whether all entries of a list, or of nested lists of one length, are numbers."""
    try:
        return np.asarray(values).dtype.kind in "iuf"
    except ValueError:  # lists of different lengths
        return False


def _may_be_number(value: Any, kind: Any) -> bool:
    """Return whether a value is a number, or None if its annotation allows a number."""
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        return False
    return kind is None or bool({int, float, Array} & {kind, *typing.get_args(kind)})


def with_numbers(scenario: Any, values: Mapping[str, float]) -> Any:
    """Return the scenario with other numbers at addresses that `numbers` knows."""
    for address, value in values.items():
        scenario = _with_number(scenario, address, value)
    return scenario


def _with_number(parent: Any, address: str, value: float) -> Any:
    """Return a struct or dictionary with another number at an address in it."""
    head, _, rest = address.partition(".")
    name = stem(head)
    index = index_of(head)
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


def with_value(scenario: S, address: str, value: Any) -> S:
    """Return a scenario with another value at an address.

    Args:
        scenario: the scenario.
        address: dotted key, with an index for one entry: `sensor.right`, `plant.A[1,0]`.
        value: number, list, text, table, or a struct such as `Kalman()`.

    Raises:
        InputError: no such key, or a value that it cannot take.
    """
    match = re.fullmatch(r"([\w.]+)(?:\[(\s*\d+\s*(?:,\s*\d+\s*)*)\])?", address.strip())
    if match is None:
        raise InputError(f"{address!r}: expected a key such as sensor.right or plant.A[1,0]")
    key, index = match.groups()
    if index is not None:
        present = functools.reduce(child, key.split("."), scenario)
        value = with_entry(key, present, index, value).tolist()
    *tables_above, last = key.split(".")
    change: Any = {last: value}
    for name in reversed(tables_above):
        change = {name: change}
    return with_tables(scenario, change)


def with_tables(scenario: S, changes: Mapping[str, Any]) -> S:
    """Return a scenario with other tables.

    A table keeps the keys that are not changed, unless its `kind` or `method` is another one.

    Args:
        scenario: the scenario.
        changes: values by top-level key: a struct such as `Kalman()` or a table of keys.

    Raises:
        InputError: no such key, or a value that it cannot take.
    """
    hints = typing.get_type_hints(type(scenario))
    fields: dict[str, Any] = {}
    for name, change in sorted(changes.items(), key=lambda item: item[0] == LAST):
        if name not in hints:
            near = difflib.get_close_matches(name, hints, 1) or sorted(hints)
            raise InputError(f"{name}: unknown key. Did you mean {', '.join(near)}?")
        if isinstance(change, msgspec.Struct) or change is None:
            fields[name] = change
        elif name == LAST and isinstance(change, Mapping) and "like" in change:
            observer: Any = fields.get("observer", child(scenario, "observer"))
            whole = alike(change, to_tables(observer))
            fields[name] = _merge_and_check(None, name, whole, hints[name], type(scenario))
        else:
            before = child(scenario, name)
            fields[name] = _merge_and_check(before, name, change, hints[name], type(scenario))
    return msgspec.structs.replace(scenario, **fields)


def alike(compare: Any, observer: Any) -> Any:
    """Return the table [compare], with the keys of [observer] that it lacks if it has `like`.

    Args:
        compare: the table as TOML gives it.
        observer: [observer], likewise (None: left out).

    Raises:
        InputError: `like` is something else, there is no [observer], or it has another method.
    """
    if not isinstance(compare, Mapping) or "like" not in compare:
        return compare
    if compare["like"] != "observer":
        raise InputError(f'compare.like: expected "observer", found {compare["like"]!r:.40}')
    if not isinstance(observer, Mapping):
        raise InputError("compare.like: this scenario has no [observer] whose keys could be taken")
    own = {key: value for key, value in compare.items() if key != "like"}
    if _is_another(observer, own):
        raise InputError(
            f"compare.like: takes the keys of [observer], method {observer.get('method')!r}, which "
            f"{own.get('method')!r} need not have. Leave out like, or compare.method"
        )
    return {**observer, **own}


def with_entries(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario's tables, entries by address moved to `entries` in [ensemble] and [tune].

    Raises:
        InputError: a key is not known and not an address, or an entry cannot be read.
    """
    read = {each.name: each.decode_table(data[each.name]) for each in TABLES if each.name in data}
    return {**data, **read}


def require_finite(value: Any, key: str) -> None:
    """Raise InputError if a number at or below a key is not finite, or too large."""
    if isinstance(value, dict):
        for name, child in value.items():
            require_finite(child, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, child in enumerate(value):
            require_finite(child, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        if math.isnan(value) or not key.startswith(ENDLESS):
            raise InputError(f"{key}: must be a finite number, found {value}")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{key}: the whole number is too large")


def _merge_and_check(before: Any, name: str, change: Any, annotation: Any, kind: type) -> Any:
    """Return a top-level table merged with a change and checked.

    Args:
        before: the table so far.
        name: of the table.
        change: tables and values in its place.
        annotation: its type.
        kind: of the whole scenario, for messages.

    Raises:
        InputError: a key or a value that it cannot have.
    """
    after = _merge_tables(before, change)
    require_finite(after, name)
    try:
        after = with_entries({name: after})[name]
        return msgspec.convert(after, annotation, dec_hook=decode_field)
    except msgspec.ValidationError as error:
        message = f"{error} - at `$.{name}`"
        raise InputError(explain(message, {name: after}, kind)) from None


def _merge_tables(before: Any, change: Any) -> Any:
    """Return a value as TOML would give it: tables merged key by key, anything else replaced."""
    if isinstance(change, msgspec.Struct):
        return to_tables(change)
    if isinstance(change, np.ndarray | np.number):
        return change.tolist()
    if not isinstance(change, Mapping):
        return change
    present = to_tables(before) if isinstance(before, msgspec.Struct) else before
    if not isinstance(present, Mapping) or _is_another(present, change):
        present = {}
    merged = dict(present)
    for name, value in change.items():
        merged[name] = _merge_tables(merged.get(name), value)
    return merged


def _is_another(present: Mapping[str, Any], change: Mapping[str, Any]) -> bool:
    """Return whether a change chooses another variant of a table."""
    return any(key in change and change[key] != present.get(key) for key in CHOOSERS)
