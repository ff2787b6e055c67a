"""Tables without a column for each signal: a line for each value, a trace in blocks, Parquet."""

from __future__ import annotations

import functools
import io
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from undeadzone.errors import FileError
from undeadzone.logs.kinds import split_unit, time_rank
from undeadzone.logs.samples import FIRST, numbers_of_texts
from undeadzone.logs.stamps import stamps_of
from undeadzone.logs.text import (
    Text,
    blocks_of,
    decimal_mark,
    dialect_of,
    is_content,
    parse_cell,
    split_cells,
)
from undeadzone.logs.whole import to_numbers
from undeadzone.util.arrays import Floats
from undeadzone.util.files import LARGEST_TABLE, convert_read_errors, read_bytes

Arrays = dict[str, Floats]  # by the names of the signals, and their times
Table = tuple[list[str], list[tuple[str, ...]]]  # titles of columns, and their cells
FEWEST_VALUES = 3  # of two signals; others may be stored on change
# title of a column of names
OF_NAMES = re.compile(r"(?i)tag|name|signal|point|variable|\bloop|field|measurement|asset")
# a label and its value, `pwm: 120` or `pwm = 120`
LABELLED = re.compile(
    r"([^\W\d][\w .()/%°-]*?)\s*[:=]\s*([-+]?\.?\d[\d.]*(?:[eE][-+]?\d+)?)(?![\d:])"
)
OF_VALUES = re.compile(r"(?i)value|wert|reading|\bval\b")  # and of that of the values
MOST_NUMBERS = 0.9  # share of the cells of a column that are numbers, or of a column of names not


def read_parquet(path: Path) -> Arrays:
    """Read the columns of a Parquet file; a column of lists is a matrix. Raises FileError."""
    content = read_bytes(path, LARGEST_TABLE)
    try:
        from pyarrow import parquet
    except ImportError:
        how = "pip install 'undeadzone[parquet]', or save it as CSV"
        raise FileError(f"{path}: a .parquet file needs pyarrow: {how}") from None
    with convert_read_errors(path):
        table = parquet.read_table(io.BytesIO(content))
        return {name: _numbers(name, table[name].to_numpy()) for name in table.column_names}


def _numbers(name: str, values: Any) -> Any:
    """Return a column of lists as a matrix, another as `to_numbers` does."""
    return np.stack(values) if values.dtype.kind == "O" else to_numbers(name, values)


def read_named_values(path: Path) -> Arrays | None:
    """Read a text that names each value: `pwm: 120, rpm: 33`, or a name, a time and a value in each
    line; None for any other table.

    A trace of a PLC names its values ahead of them. Other signals count at the times of the one
    that has most values, as they last were.
    """
    lines = read_lines(path)
    return _read_labels(lines) or signals_of_columns(*columns_of_lines(lines))


def _read_labels(lines: Sequence[str]) -> Arrays | None:
    """Return the signals of lines with a label ahead of each value, and of a time ahead of all.

    None where most lines do not have the same labels.
    """
    rows = list(map(LABELLED.split, lines))  # what is ahead, then label, value, rest
    names = Counter(tuple(row[1::3]) for row in rows).most_common(1)[0][0]
    alike = [[row[0].strip(" \t-=>,;[]"), *row[2::3]] for row in rows if tuple(row[1::3]) == names]
    if not names or len(alike) < MOST_NUMBERS * len(lines):
        return None
    titles = ["time", *names]
    numbers, _ = numbers_of_columns(titles, list(zip(*alike, strict=True)))
    return {name: x for name, x in zip(titles, numbers, strict=True) if np.isfinite(x).any()}


def read_lines(path: Path) -> list[str]:
    """Read the lines with content of a text. Raises FileError."""
    blocks = itertools.starmap(Text(str(path)).feed, blocks_of(path, LARGEST_TABLE))
    return list(filter(is_content, itertools.chain.from_iterable(blocks)))


def signals_of_columns(titles: Sequence[str], columns: Sequence[Sequence[str]]) -> Arrays | None:
    """Return the signals of a long table; None for any other table. See `read_named_values`.

    Args:
        titles: of its columns.
        columns: their cells.
    """
    numbers, times, values, names = part_columns(titles, columns)
    values, names = (  # a quality or a remark stands beside
        [k for k in each if title.search(titles[k])] or each
        for each, title in ((values, OF_VALUES), (names, OF_NAMES))
    )
    is_named = len(names) == 1 or all(OF_NAMES.search(titles[k]) for k in names)
    if not times or len(values) != 1 or not names or not is_named:
        return None
    name = np.array(list(map(".".join, zip(*(columns[k] for k in names), strict=True))))
    t = numbers[times[0]]
    known = np.isfinite(t) & np.isfinite(numbers[values[0]])
    different, of, counts = np.unique(name[known], return_inverse=True, return_counts=True)
    if different.size < 2 or np.sort(counts)[-2] < FEWEST_VALUES:
        return None
    t, x = t[known], numbers[values[0]][known]
    base = np.unique(t[of == np.argmax(counts)])
    late = base + np.median(np.diff(base)) / 2
    title = titles[times[0]]
    arrays = {title if names_times(title) else "t": base}
    for k in np.argsort(np.unique(of, return_index=True)[1]):
        own, order = np.unique(t[of == k], return_index=True)
        before = np.searchsorted(own, late) - 1
        arrays[str(different[k])] = np.where(before < 0, np.nan, x[of == k][order][before])
    return arrays


def part_columns(
    titles: Sequence[str], columns: Sequence[Sequence[str]]
) -> tuple[list[Floats], list[int], list[int], list[int]]:
    """Return the numbers of columns, and the columns of times, of values and of names.

    Arguments and times are those of `numbers_of_columns`.
    """
    numbers, times = numbers_of_columns(titles, columns)
    full = [bool(np.isfinite(x).mean() > MOST_NUMBERS) for x in numbers]
    others = [k for k in range(len(full)) if k not in times]
    values = list(filter(full.__getitem__, others))
    return numbers, times, values, [k for k in others if not full[k]]


def numbers_of_columns(
    titles: Sequence[str], columns: Sequence[Sequence[str]]
) -> tuple[list[Floats], list[int]]:
    """Return the numbers of columns, and the columns of times, the best first.

    A column of dates is joined with one of times of day.

    Args:
        titles: of the columns.
        columns: their cells.
    """
    mark, _ = decimal_mark(zip(*columns, strict=True), "", True, "")
    parse = functools.partial(parse_cell, mark=mark)
    numbers = [numbers_of_texts(x, parse) for x in columns]
    dated, clocks, others = list[int](), list[int](), list[int]()
    for k, (title, cells) in enumerate(zip(titles, columns, strict=False)):
        stamps = stamps_of(cells[:FIRST])
        if stamps:
            (dated if stamps.dated else clocks).append(k)
        elif names_times(title):
            others.append(k)
    if dated and clocks and ":" not in columns[dated[0]][0]:
        joined = map(" ".join, zip(columns[dated[0]], columns[clocks[0]], strict=True))
        numbers[dated[0]] = numbers_of_texts(list(joined), parse)
    return numbers, [*dated, *clocks, *others]


def names_times(title: str) -> bool:
    """Return whether a column has times by its title."""
    return time_rank(split_unit(title)) >= 0


def columns_of_lines(lines: Sequence[str]) -> Table:
    """Return the titles of columns, "" without a header, and their cells.

    Pairs of columns, of which the first has a tag above its times, become lines of a long table,
    and so do lines with one value each.
    """
    dialect = dialect_of(lines[:FIRST])
    tags = split_cells(lines[0], dialect.separator)
    if dialect.titles and len(tags) > 2 and not any(tags[1::2]):
        split = functools.partial(split_cells, separator=dialect.separator)
        table = list(itertools.zip_longest(*map(split, lines[1:]), fillvalue=""))
        return _join_signals(zip(tags[::2], table[::2], table[1::2], strict=False))
    width = dialect.width
    titles = [f"{name} [{unit}]".removesuffix(" []") for name, unit in dialect.titles or ()] or [
        ""
    ] * width
    rows = []
    name = ""
    for line in lines[dialect.heads :]:
        cells = split_cells(line, dialect.separator)
        if cells[0].endswith(".Variable"):
            name, width, titles = cells[-1], 3, ["", "t [ms]", ""]
        rows.append([cells[0] or name, *cells[1:]])
    rows = [row for row in rows if len(row) == width]
    columns = list(zip(*rows, strict=True))
    if width > 2 and sum(sum(map(bool, row)) == 2 for row in rows) > MOST_NUMBERS * len(rows):
        return _join_signals(
            zip(titles[1:], itertools.repeat(columns[0]), columns[1:], strict=False)
        )
    return titles, columns


def columns_of_files(files: Iterable[tuple[str, Path]]) -> Table:
    """Return the columns of a long table of files of values, with times or without.

    Args:
        files: names of signals, and their files.

    Raises:
        FileError: one cannot be read.
    """
    signals = []
    for name, path in files:
        titles, columns = columns_of_lines(read_lines(path))
        numbers, times = numbers_of_columns(titles, columns)
        values = [k for k, x in enumerate(numbers) if k not in times and np.isfinite(x).any()]
        if not values:
            raise FileError(f"{path}: expected a column of values")
        x = columns[values[0]]
        signals.append((name, columns[times[0]] if times else [*map(str, range(len(x)))], x))
    return _join_signals(signals)


def _join_signals(signals: Iterable[tuple[str, Sequence[str], Sequence[str]]]) -> Table:
    """Return the columns of a long table by the name, the times and the values of each signal."""
    lines = list[tuple[str, ...]]()
    for name, t, x in signals:
        lines += zip(t, itertools.repeat(name), x, strict=False)
    return ["time", "tag", "value"], list(zip(*filter(all, lines), strict=True))
