"""Which column is which: by the names that a user gives, else by the usual names of t, u and y."""

from __future__ import annotations

import difflib
import re

from undeadzone.errors import FileError
from undeadzone.identification.log import Column

TIMES = ("t", "time", "times", "zeit", "temps", "tiempo", "timestamp", "seconds", "sec")
INPUTS = ("u", "input", "in", "command", "control")
OUTPUTS = ("y", "output", "out", "reading", "measured", "measurement")
INDEXED = re.compile(r"^(.*?)[\[_(]?(\d+)[\])]?$")


class Chosen:
    """The columns of a log.

    Attributes:
        time, output: the columns of times and readings.
        inputs: the columns of the inputs, in order.
    """

    def __init__(self, time: Column, inputs: list[Column], output: Column) -> None:
        self.time = time
        self.inputs = inputs
        self.output = output


def choose(
    columns: list[Column],
    named: bool,
    source: str,
    time: str | None = None,
    inputs: str | None = None,
    output: str | None = None,
) -> Chosen:
    """The columns of time, inputs and reading.

    Args:
        columns: what the file holds.
        named: whether the columns have names; without them three columns are t, u, y.
        source: the file, for messages.
        time, output: name or number (from 1) of a column; default: the usual names.
        inputs: the same, several separated by commas.

    Returns:
        The columns.

    Raises:
        FileError: no such column, or names that do not say which column is which.
    """
    if not named and time is None and inputs is None and output is None:
        if len(columns) != 3:
            raise FileError(
                f"{source}: without a header 3 columns are expected, t, u, y; found {len(columns)};"
                " add a header, or say --time, --input and --output with column numbers"
            )
        return Chosen(columns[0], [columns[1]], columns[2])
    first = _one(columns, time, TIMES, "--time", "times", source)
    last = _one(columns, output, OUTPUTS, "--output", "readings", source)
    if inputs is not None:
        chosen = [_named(columns, name, "--input", source) for name in inputs.split(",")]
    else:
        chosen = _usual(columns, INPUTS)
    if not chosen:
        raise FileError(_unknown(columns, "inputs", "--input", source))
    for column in chosen:
        if column is first or column is last or first is last:
            raise FileError(f"{source}: column {column.name!r} is used twice")
    return Chosen(first, chosen, last)


def _one(
    columns: list[Column],
    name: str | None,
    usual: tuple[str, ...],
    option: str,
    what: str,
    source: str,
) -> Column:
    """The one column of that name, or of a usual name. Raises FileError."""
    if name is not None:
        return _named(columns, name, option, source)
    found_columns = _usual(columns, usual)
    if not found_columns:
        raise FileError(_unknown(columns, what, option, source))
    if len(found_columns) > 1:
        raise FileError(
            f"{source}: {len(found_columns)} columns may be the {what}:"
            f" {_listed(found_columns)}; say which by {option}"
        )
    return found_columns[0]


def _usual(columns: list[Column], usual: tuple[str, ...]) -> list[Column]:
    """The columns of a usual name, `u` before `u[0]`, `u1`, ..."""
    for name in usual:
        same = [column for column in columns if column.name.lower() == name]
        if same:
            return same
    for name in usual:
        indexed = [column for column in columns if _stem(column.name) == name]
        if indexed:
            return indexed
    return []


def _stem(name: str) -> str:
    """The name without an index: `u` of `u[0]`, `u_1`, `u2`; the name itself if it has none."""
    match = INDEXED.match(name.lower())
    return match[1] if match else name.lower()


def _named(columns: list[Column], name: str, option: str, source: str) -> Column:
    """The column of that name or number. Raises FileError with the nearest names."""
    wanted = name.strip()
    for column in columns:
        if column.name == wanted:
            return column
    same = [column for column in columns if column.name.lower() == wanted.lower()]
    if len(same) == 1:
        return same[0]
    if wanted.isdigit() and 1 <= int(wanted) <= len(columns):
        return columns[int(wanted) - 1]
    names = [column.name for column in columns]
    near = difflib.get_close_matches(wanted, names, n=3)
    hint = f"; near: {', '.join(near)}" if near else ""
    raise FileError(f"{source}: {option}: no column {wanted!r}; there are {_listed(columns)}{hint}")


def _unknown(columns: list[Column], what: str, option: str, source: str) -> str:
    """The message where no name says which column holds something."""
    return (
        f"{source}: no name says which column holds the {what}; there are {_listed(columns)};"
        f" say which by {option} NAME"
    )


def _listed(columns: list[Column]) -> str:
    """Names of columns as text."""
    return ", ".join(repr(column.name) for column in columns[:12])
