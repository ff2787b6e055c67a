"""The numbers of a step that stay parameters of the exported code; all others are folded in."""

from __future__ import annotations

import difflib
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.errors import InputError
from undeadzone.exports.fields import Field
from undeadzone.support import tree
from undeadzone.support.arrays import Floats


class Params(NamedTuple):
    """The tunable numbers as symbols and as fields."""

    symbols: ca.SX
    fields: list[Field]


def folded(numbers: Any, tunable: tuple[str, ...]) -> tuple[ca.SX, Params, Floats]:
    """(all numbers as one column of constants and symbols, the tunable ones, their values)."""
    places = dict(zip([name for name, _ in tree.leaves(numbers)], _slices(numbers), strict=True))
    values = tree.pack(numbers)
    column = ca.SX(ca.DM(values))
    symbols = [ca.SX(0, 1)]
    fields: list[Field] = []
    defaults: list[Floats] = [np.empty(0)]
    for name in tunable:
        place = _place(name, places)
        size = place.stop - place.start
        symbol = ca.SX.sym(name.replace(".", "_"), size)
        column[place] = symbol
        if name == "sensor.threshold" and "observer.threshold" in places:
            column[places["observer.threshold"]] = symbol  # the same number, held by the observer
        symbols.append(symbol)
        defaults.append(values[place])
        meaning = f"{name}, as one sample uses it (gains per sample, not per second)"
        fields.append(Field(name.replace(".", "_"), size, meaning))
    return column, Params(ca.vertcat(*symbols), fields), np.concatenate(defaults)


def _slices(numbers: Any) -> list[slice]:
    """Where each leaf stands in the column."""
    return [part for _, part in tree.leaves(tree.slices(numbers))]


def _place(name: str, places: dict[str, slice]) -> slice:
    """Where a tunable number stands. Raises InputError with the nearest names."""
    known = sorted(key for key, place in places.items() if place.stop > place.start)
    if name in known:
        return places[name]
    nearest = difflib.get_close_matches(name, known, 3, 0.4) or known
    raise InputError(f"tunable: no number {name!r}; did you mean {', '.join(nearest)}?")


def require_used(every: ca.SX, params: Params, tunable: tuple[str, ...]) -> None:
    """Raise InputError for a tunable number on which nothing depends."""
    start = 0
    for name, field in zip(tunable, params.fields, strict=True):
        symbols = params.symbols[start : start + field.size]
        if not ca.depends_on(every, symbols):
            raise InputError(f"tunable: {name} changes nothing in a step of this observer")
        start += field.size
