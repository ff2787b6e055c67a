"""Tables without a column for each signal: a line for each value, a trace in blocks, Parquet."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from undeadzone.errors import FileError
from undeadzone.logs.kinds import time_rank
from undeadzone.logs.samples import FIRST, numbers_of_texts
from undeadzone.logs.stamps import stamps_of
from undeadzone.logs.text import Text, blocks_of, dialect_of, is_content, parse_cell
from undeadzone.util.arrays import Floats
from undeadzone.util.files import LARGEST_TABLE, read_bytes, unreadable_file

Arrays = dict[str, Floats]  # by the names of the signals, and their times
BLOCK = re.compile(r"\d+\.Variable; *(\S.*)")  # line of a PLC's trace that names its values
FEWEST_VALUES = 3  # of each signal


def read_parquet(path: Path) -> Arrays:
    """Read the columns of a Parquet file; a column of lists is a matrix.

    Raises:
        FileError: without pyarrow, or it cannot be read.
    """
    content = read_bytes(path, LARGEST_TABLE)
    try:
        from pyarrow import parquet
    except ImportError:
        raise FileError(
            f"{path}: a .parquet file needs pyarrow: pip install 'undeadzone[parquet]', or save it"
            " as CSV"
        ) from None
    try:
        table = parquet.read_table(io.BytesIO(content))
    except (OSError, ValueError) as error:
        raise unreadable_file(path, error) from None
    arrays = {}
    for name in table.column_names:
        values = table[name].to_numpy()
        if values.dtype.kind == "O" and len({np.shape(value) for value in values}) == 1:
            values = np.stack(values)
        if values.dtype.kind == "M":
            values = (values - values[0]) / np.timedelta64(1, "s")
        arrays[name] = values
    return arrays


def read_long_table(path: Path) -> Arrays | None:
    """Read a text with a name, a time and a value in each line; None for any other table.

    A trace of a PLC names its values ahead of them. Other signals count at the times of the one
    that has most values, as they last were.
    """
    text = Text(str(path))
    blocks = (text.feed(data, last) for data, last in blocks_of(path, LARGEST_TABLE))
    lines = list(filter(is_content, itertools.chain.from_iterable(blocks)))
    found = _blocks(lines) if any(map(BLOCK.match, lines)) else _columns(lines)
    if found is None:
        return None
    names, times, values = found
    known = np.isfinite(times) & np.isfinite(values)
    signals = {name: known & (names == name) for name in dict.fromkeys(names.tolist())}
    if min(map(np.sum, signals.values())) < FEWEST_VALUES or len(signals) < 2:
        return None
    base = np.unique(times[max(signals.values(), key=np.sum)])
    late = base + np.median(np.diff(base)) / 2
    arrays = {"time": base - base[0]}
    for name, rows in signals.items():
        t, order = np.unique(times[rows], return_index=True)
        before = np.searchsorted(t, late) - 1
        arrays[name] = np.where(before < 0, np.nan, values[rows][order][before])
    return arrays


def _blocks(lines: Sequence[str]) -> tuple[np.ndarray, Floats, Floats]:
    """Return names, times [s] and values of the lines of a PLC's trace, which counts in ms."""
    rows = []
    name = ""
    for line in lines:
        named = BLOCK.match(line)
        name = named[1].strip() if named else name
        cells = line.split(";")
        if len(cells) == 3 and not cells[0].strip():
            rows.append((name, cells[1].strip(), cells[2].strip()))
    names, times, values = zip(*rows, strict=True) if rows else ((), (), ())
    t, x = (numbers_of_texts(texts, _number) for texts in (times, values))
    return np.array(names), 1e-3 * t, x


def _columns(lines: Sequence[str]) -> tuple[np.ndarray, Floats, Floats] | None:
    """Return names, times [s] and values of lines; None unless one column is each of these."""
    dialect = dialect_of(lines[:FIRST])
    rows = [row for row in map(dialect.cells, lines[dialect.heads :]) if len(row) == dialect.width]
    columns = list(zip(*rows, strict=True))
    numeric = [numbers_of_texts(texts, _number) for texts in columns]
    is_number = [bool(np.isfinite(x).mean() > 0.9) for x in numeric]
    stamped = [stamps_of(texts[:FIRST]) is not None for texts in columns]
    titled = [time_rank(title) >= 0 for title in dialect.titles or ()] or stamped
    times = [k for k, is_time in enumerate(titled) if is_time or stamped[k]]
    values = [k for k, is_one in enumerate(is_number) if is_one and k not in times]
    texts = [k for k in range(len(columns)) if k not in times + values]
    names = [k for k in texts if 1 < len({*columns[k]}) <= len(rows) // FEWEST_VALUES]
    if len(values) != 1 or len(names) != 1 or not times:
        return None
    stamps = [" ".join(parts) for parts in zip(*(columns[k] for k in times), strict=True)]
    return np.array(columns[names[0]]), numbers_of_texts(stamps, _number), numeric[values[0]]


def _number(cell: str) -> float | None:
    """Return the number in a cell with a decimal point; None if there is none."""
    return parse_cell(cell, ".")
