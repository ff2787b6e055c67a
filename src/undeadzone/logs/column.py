"""A column of a log: its name, its unit, and how long a unit of time is."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.support.arrays import Floats

# Length of a unit of time [s]. A time that counts samples has no length of its own.
SECONDS: Final = {
    "": 1.0,
    "s": 1.0,
    "sec": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
}
COUNTS: Final = ("sample", "samples")


class Column(NamedTuple):
    """A column of a table: its name without the unit, its unit ("" if none), its numbers (N)."""

    name: str
    unit: str
    values: Floats


class Title(NamedTuple):
    """What a header says of a column: its name, its unit ("" if none)."""

    name: str
    unit: str


def split_unit(text: str) -> Title:
    """Name and unit of a header: `speed [rad/s]` or `speed (rad/s)`.

    An index is no unit: `u[0]`. A 1 after a space is: `u[0] [1]` has no dimension.
    """
    title = text.strip().strip("\"'").strip()
    for opening, closing in (("[", "]"), ("(", ")")):
        start = title.rfind(opening)
        if start <= 0 or not title.endswith(closing):
            continue
        inside = title[start + 1 : -1].strip()
        of_no_dimension = inside == "1" and title[start - 1] == " "
        if of_no_dimension or not inside.isdigit():
            return Title(title[:start].strip(), inside)
    return Title(title, "")


def numbers(key: str, value: Any, kinds: str) -> Floats:
    """An array of floats, NaN and infinite ones among them.

    Args:
        key: what the user calls it.
        value: anything that NumPy makes an array of.
        kinds: NumPy's letters of the types that count as numbers.

    Raises:
        InputError: for rows of different lengths, and what is no number.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(f"{key}: expected numbers in a rectangular list") from None
    if array.dtype.kind not in kinds:
        raise InputError(f"{key}: expected numbers, found {array.dtype}")
    return array.astype(float)
