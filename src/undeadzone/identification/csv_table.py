"""CSV files of any dialect: separator, decimal comma, remarks, byte order mark, units in names."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from undeadzone.errors import FileError
from undeadzone.logs.column import Column, split_unit
from undeadzone.logs.dialect import BRACKETED, is_content, split
from undeadzone.support.arrays import Floats
from undeadzone.support.files import LARGEST_TABLE, read_bytes, reason

MISSING = ("", "nan", "na", "n/a", "null", "none", "-", "--", "inf", "-inf", "+inf")


class Table(NamedTuple):
    """What a CSV file holds.

    Attributes:
        columns: its columns.
        lines: line of each row in the file (N).
        named: whether it has a header.
    """

    columns: list[Column]
    lines: Floats
    named: bool


def read_csv(path: Path) -> Table:
    """The table in a CSV file.

    Args:
        path: a text file with separator `,`, `;`, tab or blanks, with or without a header.

    Returns:
        Its columns; missing or unreadable-as-missing cells (empty, NaN) are NaN.

    Raises:
        FileError: no text, no numbers, rows of different lengths, a cell that is no number.
    """
    numbers, rows = _lines_with_content(_text(path))
    if not rows:
        raise FileError(f"{path}: holds no samples")
    separator = _separator(rows)
    cells = [split(row, separator) for row in rows]
    heads = _header_rows(cells)
    header = cells[0] if heads else []
    units = cells[1] if heads == 2 else []
    body, lines = cells[heads:], numbers[heads:]
    if not body:
        raise FileError(f"{path}: a header and no samples")
    _check_widths(path, body, lines, len(header) or len(body[0]))
    values = _values(path, body, lines, separator != ",")
    columns = []
    for k in range(values.shape[1]):
        name, unit = split_unit(header[k]) if header else (str(k + 1), "")
        if units:
            unit = unit or units[k].strip("[]() ")
        columns.append(Column(name, unit, values[:, k]))
    return Table(columns, np.array(lines, float), bool(header))


def _text(path: Path) -> str:
    """The text of a file: UTF-8, UTF-16 with its mark, else Windows' Western European."""
    try:
        data = read_bytes(path, LARGEST_TABLE)
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings = ["utf-16"]
    else:
        encodings = ["utf-8-sig", "cp1252"]
    if b"\0" in data and encodings[0] != "utf-16":
        raise FileError(f"{path}: not a text file; use CSV, .npz, or .mat saved with -v7")
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise FileError(f"{path}: not text in UTF-8; save it as CSV in UTF-8")


def _lines_with_content(text: str) -> tuple[list[int], list[str]]:
    """Line numbers and texts of the lines that are neither empty nor remarks."""
    numbers, rows = [], []
    for number, line in enumerate(text.splitlines(), 1):
        if is_content(line):
            numbers.append(number)
            rows.append(line.strip("\r\n"))
    return numbers, rows


def _separator(rows: list[str]) -> str:
    """The separator: the first of `;`, tab, `,` that the middle line holds, else blanks."""
    sample = rows[len(rows) // 2]
    for candidate in (";", "\t", ","):
        if candidate in sample:
            return candidate
    return " "


def _header_rows(cells: list[list[str]]) -> int:
    """How many rows come before the numbers: 0, 1 (names) or 2 (names, units)."""
    if any(_number(cell) is not None for cell in cells[0]):
        return 0
    if all(cell.lower() in MISSING for cell in cells[0]):
        return 0
    if len(cells) > 1 and len(cells[1]) == len(cells[0]):
        second = [cell for cell in cells[1] if cell]
        if second and all(BRACKETED.match(cell) for cell in second):
            return 2
    return 1


def _check_widths(path: Path, body: list[list[str]], lines: list[int], width: int) -> None:
    """Every row has as many cells as the header; one empty cell may follow. Raises FileError."""
    for row, line in zip(body, lines, strict=True):
        if len(row) == width + 1 and not row[-1]:
            del row[-1]
        if len(row) != width:
            raise FileError(
                f"{path}, line {line}: expected {width} columns, found {len(row)}; a line cut"
                " short, or another separator?"
            )


def _values(path: Path, body: list[list[str]], lines: list[int], comma: bool) -> Floats:
    """The numbers of a table (rows x columns). Raises FileError with line and column."""
    try:
        return np.array(body, float)
    except ValueError:
        pass  # a missing or bad cell somewhere: look at each
    values = np.empty((len(body), len(body[0])))
    for i, row in enumerate(body):
        for k, cell in enumerate(row):
            number = _number(cell, comma)
            if number is None:
                if cell.lower() not in MISSING:
                    raise FileError(
                        f"{path}, line {lines[i]}, column {k + 1}: expected a number or nothing,"
                        f" found {cell!r:.40}"
                    )
                number = np.nan
            values[i, k] = number
    return values


def _number(cell: str, comma: bool = True) -> float | None:
    """The number in a cell, a decimal comma allowed; None if it is none."""
    try:
        return float(cell)
    except ValueError:
        pass
    if not comma or cell.count(",") != 1:
        return None
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return None
