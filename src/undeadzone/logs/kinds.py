"""Kinds and ranks of columns, by the words and the units of their names, in a single table.

A name opens candidates: `names` compares them by what their columns do.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone.util.files import read_table


def _compile_pieces(pieces: list[str]) -> re.Pattern[str]:
    """Return the pattern that is written in pieces."""
    return re.compile("".join(pieces))


_TABLES: Final = read_table(__file__)
# Length of a unit of time [s]. A time that counts samples has no length of its own.
SECONDS: Final[dict[str, float]] = _TABLES["seconds"]
OF_TIME: Final = ("s", "sec", "second", "seconds")  # units that show a time by themselves
COUNTS: Final = ("sample", "samples", "step", "steps", "index", "row", "frame")
# Names of times, best first: alone, with a unit, and with words that say of what.
_TIMES: Final = list(map(_compile_pieces, _TABLES["names"]["times"]))
VAGUE: Final = len(_TIMES) - 1  # rank from which a time must run as times do
# A unit at the end of a name: `motor_deg`, `force_N`. Letters that often mean something else are
# none.
_WITH_UNIT: Final = re.compile(
    r"(.*[^\W_])[_ ](N|Nm|V|A|K|W|(?i:deg|rad|mrad|arcsec|arcmin|mm|cm|um|inch|us|ms|ns|px|counts"
    r"|pct|percent|mv|ma|volts?|amps?|newtons?|pa|kpa|bar|psi|degc|celsius|kelvin|kg|rpm|lpm))"
)
_WORDS: Final = re.compile(r"[A-Z]+(?![a-zµμß-ÿ])|[A-ZÀ-Þ]?[^\W\d_A-Z]+|[A-Z]+|\d+|[°%]")

TABLE: Final = 160  # rows that someone has written down, at most
EXACT: Final = 20.0  # rank of names without doubt
REFERENCE: Final = 10.0  # rank of what a loop follows, which drives no plant by itself
# Rows of a pattern, the kind that it shows ("" if it shows none) and a rank: the largest drives,
# the least is read. The first row that fits a name decides.
_TABLE: Final = [
    (_compile_pieces(pieces), kind, rank) for pieces, kind, rank in _TABLES["names"]["kinds"]
]


class Title(NamedTuple):
    """Title of a column in a header: its name, its unit ("" if none)."""

    name: str
    unit: str


def split_unit(text: str) -> Title:
    """Name and unit of a header: `speed [rad/s]` or `speed (rad/s)`.

    An index is no unit: `u[0]`, `pos (1)`. `[1]` after a space is: `u[0] [1]` has no dimension.
    """
    title = text.strip().strip("\"'").strip()
    for opening, closing in (("[", "]"), ("(", ")")):
        start = title.rfind(opening)
        if start <= 0 or not title.endswith(closing):
            continue
        inside = title[start + 1 : -1].strip()
        of_no_dimension = inside == "1" and opening == "[" and title[start - 1] == " "
        if of_no_dimension or not inside.isdigit():
            return Title(title[:start].strip(), inside)
    return Title(title, "")


def add_unit(title: Title) -> Title:
    """Return a title with the unit at the end of its name, unless it has a unit already."""
    found = _WITH_UNIT.fullmatch(title.name)
    return Title(title.name, found[2]) if found and not title.unit else title


def split_words(name: str) -> str:
    """Return a name in small letters, with blanks between its words and no unit at their end."""
    found = _WITH_UNIT.fullmatch(name)
    return " ".join(_WORDS.findall(found[1] if found else name)).lower()


def kind_of(name: str, unit: str = "") -> str:
    """Return the kind of quantity in a column, of the kinds in the table, or "other".

    The kinds are goal, position, speed, torque, drive, op, pv, sp, force, and aside of what is
    recorded beside input and reading.

    Args:
        name: of the column.
        unit: of the column; "" or "1" if it has none.
    """
    rows = _rows_of(Title(name, unit))
    return next((kind for _, kind, _ in rows if kind), "other")


def rank_of(title: Title) -> float:
    """Return how likely a column drives (> 0) or is read (< 0) by its name; 0: nothing is known."""
    return next((rank for _, _, rank in _rows_of(title)), 0.0)


def _rows_of(title: Title) -> list[tuple[re.Pattern[str], str, float]]:
    """Return the rows of the table that fit a title."""
    title = add_unit(title)
    words = split_words(title.name)
    texts = (words, f"{words} [{title.unit.lower()}]")
    return [row for row in _TABLE if any(map(row[0].search, texts))]


def time_rank(title: Title) -> int:
    """Return the rank of a name among the names of times, 0 the best; -1 for any other name."""
    words = " ".join(_WORDS.findall(title.name)).lower()
    by_unit = len(_TIMES) if title.unit.lower() in OF_TIME else -1
    return next((k for k, name in enumerate(_TIMES) if name.search(words)), by_unit)


def increases_evenly(values: Floats) -> bool:
    """Return whether values increase from 0 or later by about equal steps, as times and indices do.

    So do those of a log with the newest first.

    Args:
        values: of a column (N).
    """
    values = values[np.isfinite(values)]
    between = np.diff(values)
    between *= np.sign(np.median(between)) if between.size else 1.0
    is_rising = between.size > 1 and values.min() >= 0 and np.mean(between > 0) > 0.98
    return bool(
        is_rising and np.quantile(between, 0.9, method="higher") <= 1.5 * np.median(between)
    )


def is_regular_time(values: Floats) -> bool:
    """Return whether values increase regularly, and do not just count from 0 or 1.

    Args:
        values: of a column (N).
    """
    return increases_evenly(values) and not counts_rows(values)


def counts_rows(values: Floats) -> bool:
    """Return whether values are the numbers of their rows, from 0 or 1 on.

    Args:
        values: of a column (N).
    """
    return bool((np.diff(values) == 1).all()) and values[0] in (0, 1)
