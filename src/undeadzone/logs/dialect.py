"""The dialect of a CSV text: its separator, its decimal comma, its remarks, its header."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final, NamedTuple

from undeadzone.logs.column import Title, split_unit

REMARKS: Final = ("#", "%", "//")
# What stands in a cell whose number is missing.
MISSING: Final = frozenset(
    ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "+inf", "infinity", "?")
)
LARGEST: Final = 1e50  # beyond this no unit makes sense
_BLANKS_BETWEEN: Final = re.compile(r"\d,\d+ +[-+]?\d")
BRACKETED: Final = re.compile(r"^\[.*\]$|^\(.*\)$")


class Dialect(NamedTuple):
    """How a CSV text is written.

    Attributes:
        separator: between two cells: `;`, a tab, a comma, or " " for any number of blanks.
        width: cells in a line.
        titles: of the columns; None without a header.
        heads: lines before the numbers: none, the names, or names and units.
    """

    separator: str
    width: int
    titles: tuple[Title, ...] | None
    heads: int

    def cells(self, line: str) -> list[str]:
        """The cells of a line, without what surrounds them; one separator may end the line."""
        cells = split(line, self.separator)
        if len(cells) == self.width + 1 and not cells[-1]:
            cells.pop()
        return cells

    def number(self, cell: str) -> float | None:
        """The number in a cell, NaN where it is missing; None where it cannot be read."""
        return number(cell, self.separator != ",")


def is_content(line: str) -> bool:
    """Whether a line is neither empty nor a remark."""
    stripped = line.strip()
    return bool(stripped) and not stripped.startswith(REMARKS)


def dialect_of(lines: Sequence[str]) -> Dialect:
    """The dialect of a text.

    Args:
        lines: its first lines with content, at least one.
    """
    separator = _separator(lines)
    first = split(lines[0], separator)
    heads = _heads(lines, separator)
    if heads == 0:
        return Dialect(separator, len(first), None, 0)
    titles = [split_unit(cell) for cell in first]
    if heads == 2:
        units = split(lines[1], separator)
        titles = [
            Title(title.name, title.unit or unit.strip("[]() "))
            for title, unit in zip(titles, units, strict=True)
        ]
    if titles[-1].name == "":
        titles.pop()
    return Dialect(separator, len(titles), tuple(titles), heads)


def split(line: str, separator: str) -> list[str]:
    """The cells of a line, without blanks and quotes around them."""
    if separator == " ":
        return line.split()
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def number(cell: str, comma: bool) -> float | None:
    """The number in a cell, NaN where it is missing; None where it cannot be read.

    Args:
        cell: its text.
        comma: whether a decimal comma is allowed.
    """
    if cell.lower() in MISSING:
        return math.nan
    if comma and cell.count(",") == 1:
        cell = cell.replace(",", ".")
    try:
        value = float(cell)
    except ValueError:
        return None
    if abs(value) > LARGEST or "_" in cell:
        return None
    return value


def _separator(lines: Sequence[str]) -> str:
    """The separator: of `;`, tab, `,` the one that most of these lines hold, else blanks.

    Commas in numbers with blanks between are decimal commas.
    """
    best, most = " ", 0
    for candidate in (";", "\t", ","):
        holding = [line for line in lines if candidate in line]
        if candidate == ",":
            holding = [line for line in holding if not _BLANKS_BETWEEN.search(line)]
        if len(holding) > most:
            best, most = candidate, len(holding)
    return best


def _heads(lines: Sequence[str], separator: str) -> int:
    """How many lines come before the numbers: 0, 1 (names) or 2 (names, units)."""
    first = split(lines[0], separator)
    if any(number(cell, separator != ",") is not None for cell in first if cell):
        return 0
    if not any(first):
        return 0
    if len(lines) > 1:
        second = split(lines[1], separator)
        named = [cell for cell in second if cell]
        bracketed = all(BRACKETED.match(cell) for cell in named)
        if named and bracketed and len(second) == len(first):
            return 2
    return 1
