"""A scenario with other values at some of its keys."""

from __future__ import annotations

import difflib
import math
import re
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec
import numpy as np

from undeadzone.catalogue import decode
from undeadzone.errors import InputError
from undeadzone.scenario import ensemble_table as vary
from undeadzone.scenario import tune_table as tuning
from undeadzone.scenario.messages import CHOOSERS, explain
from undeadzone.support.toml import tables

S = TypeVar("S", bound=msgspec.Struct)
LAST = "compare"  # changed after [observer], whose keys it may take
ENDLESS = "sensor.range"  # the key whose numbers may be infinite; nan is refused later


def with_value(scenario: S, address: str, value: Any) -> S:
    """A scenario with another value at an address.

    Args:
        scenario: the scenario.
        address: dotted key, with an index for one entry: `sensor.right`, `plant.A[1,0]`.
        value: number, list, text, table, or a struct such as `Kalman()`.

    Raises:
        InputError: no such key, or a value that it cannot take.
    """
    match = re.fullmatch(r"([\w.]+)(?:\[([\d, ]+)\])?", address.strip())
    if match is None:
        raise InputError(f"{address!r}: expected a key such as sensor.right or plant.A[1,0]")
    key, index = match.groups()
    if index is not None:
        value = _with_entry(scenario, key, tuple(map(int, index.split(","))), value)
    *tables_above, last = key.split(".")
    change: Any = {last: value}
    for name in reversed(tables_above):
        change = {name: change}
    return with_tables(scenario, change)


def with_tables(scenario: S, changes: Mapping[str, Any]) -> S:
    """A scenario with other tables.

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
            raise InputError(f"{name}: unknown key; did you mean {', '.join(near)}?")
        if isinstance(change, msgspec.Struct) or change is None:
            fields[name] = change
        elif name == LAST and isinstance(change, Mapping) and "like" in change:
            observer: Any = fields.get("observer", _child(scenario, "observer"))
            whole = alike(change, tables(observer))
            fields[name] = _converted(None, name, whole, hints[name], type(scenario))
        else:
            before = _child(scenario, name)
            fields[name] = _converted(before, name, change, hints[name], type(scenario))
    return msgspec.structs.replace(scenario, **fields)


def alike(compare: Any, observer: Any) -> Any:
    """The table [compare], in place of `like = "observer"` all keys of [observer] that it lacks.

    Args:
        compare: the table as TOML gives it.
        observer: [observer], likewise; None: left out.

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
            f"{own.get('method')!r} need not have; leave out like, or compare.method"
        )
    return {**observer, **own}


def require_finite(value: Any, key: str) -> None:
    """Raise InputError where a number at or below a key is not finite, or too large."""
    if key == ENDLESS:
        return
    if isinstance(value, dict):
        for name, child in value.items():
            require_finite(child, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, child in enumerate(value):
            require_finite(child, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{key}: must be a finite number, found {value}")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{key}: the whole number is too large")


def _with_entry(scenario: Any, key: str, index: tuple[int, ...], value: Any) -> Any:
    """The array at a key with another entry. Raises InputError."""
    present = scenario
    for name in key.split("."):
        present = _child(present, name)
    array = np.array(0.0 if present is None else present, float)
    if present is None or array.ndim != len(index):
        raise InputError(f"{key}: has no entry [{','.join(map(str, index))}]")
    try:
        array[index] = value
    except (IndexError, ValueError, TypeError):
        listed = ",".join(map(str, index))
        raise InputError(f"{key}[{listed}]: no such entry, or {value!r:.40} is no number") from None
    return array.tolist()


def _child(parent: Any, name: str) -> Any:
    """What stands under a name; None where nothing does."""
    if isinstance(parent, Mapping):
        return parent.get(name)
    return getattr(parent, name, None)


def _converted(before: Any, name: str, change: Any, annotation: Any, kind: type) -> Any:
    """A top-level table merged with a change and checked.

    Args:
        before: the table so far.
        name: of the table.
        change: tables and values in its place.
        annotation: its type.
        kind: of the whole scenario, for messages.

    Raises:
        InputError: a key or a value that it cannot have.
    """
    after = _merged(before, change)
    require_finite(after, name)
    try:
        for table in (vary.TABLE, tuning.TABLE):
            if table.name == name:
                after = table.decoded(after)
        return msgspec.convert(after, annotation, dec_hook=decode)
    except msgspec.ValidationError as error:
        message = f"{error} - at `$.{name}`"
        raise InputError(explain(message, {name: after}, kind)) from None


def _merged(before: Any, change: Any) -> Any:
    """A value as TOML would give it: tables merged key by key, anything else replaced."""
    if isinstance(change, msgspec.Struct):
        return tables(change)
    if isinstance(change, np.ndarray | np.number):
        return change.tolist()
    if not isinstance(change, Mapping):
        return change
    present = tables(before) if isinstance(before, msgspec.Struct) else before
    if not isinstance(present, Mapping) or _is_another(present, change):
        present = {}
    merged = dict(present)
    for name, value in change.items():
        merged[name] = _merged(merged.get(name), value)
    return merged


def _is_another(present: Mapping[str, Any], change: Mapping[str, Any]) -> bool:
    """Whether a change chooses another variant of a table."""
    return any(key in change and change[key] != present.get(key) for key in CHOOSERS)
