"""A whole log at once: from .npz, .mat, JSON, a DataFrame, or arrays.

Nothing in a file is ever executed.
"""

from __future__ import annotations

import io
import itertools
import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import Title, split_unit
from undeadzone.logs.matlab73 import NUMERIC, is_matlab_73, load_matlab_73, unpacked_size
from undeadzone.logs.names import Layout, layout_of_titles, numbers
from undeadzone.logs.samples import (
    Faults,
    LogReader,
    Samples,
    numbers_of_texts,
    oldest_first,
    samples_of_text,
    split_signals,
)
from undeadzone.logs.stamps import to_seconds
from undeadzone.logs.text import LARGEST, parse_cell
from undeadzone.util.arrays import Floats
from undeadzone.util.files import (
    LARGEST_RUN,
    LARGEST_TABLE,
    convert_read_errors,
    load_arrays,
    read_bytes,
)

JSON: Final = (".json", ".jsonl", ".ndjson")  # endings of a document, or of objects, one a line
NOT_CSV: Final = (".npz", ".mat", *JSON)  # endings of files that are no CSV text
LARGEST_MATRICES: Final = LARGEST_RUN // 8  # [bytes] of a .mat file, of which each may be a number
LONGEST_CELL: Final = 64  # letters of a number or a time
COMPRESSED: Final = 15  # type of an element of a .mat file
Columns = list[tuple[Title, Floats]]  # what is said of each, and its numbers (N)


class WholeLog(NamedTuple):
    """A log as it was read.

    Attributes:
        source: its name in messages.
        samples: all of them.
        layout: its columns; None: it has none.
        faults: of its lines.
        ahead: lines ahead of the header that were skipped.
    """

    source: str
    samples: Samples
    layout: Layout | None
    faults: Faults
    ahead: int = 0


def read_whole(
    log: Any,
    p: int | None,
    m: int | None,
    chosen: Mapping[str, str],
    strict: bool,
    largest: int,
    most: float = math.inf,
) -> WholeLog:
    """Read all samples of a file of any kind, or of a DataFrame.

    Args:
        log: the DataFrame, or the path.
        p, m, chosen: as those of `samples_of`.
        strict, largest, most: of a CSV text, as those of `LogReader` and `samples_of_text`.

    Raises:
        InputError: neither a path nor a DataFrame, or a file that cannot be read.
    """
    is_path = isinstance(log, str | os.PathLike)
    if not is_path and not (hasattr(log, "columns") and hasattr(log, "index")):
        raise InputError(f"log: expected a path or a DataFrame, found {type(log).__name__}")
    source = str(log) if is_path else "DataFrame"
    log = Path(log) if is_path else log
    if not is_path or log.suffix.lower() in NOT_CSV:
        return WholeLog(source, *samples_of(log, p, m, chosen, source), Faults(source, strict))
    reader = LogReader(source, p, m, chosen, strict)
    samples = samples_of_text(reader, log, largest, most)
    return WholeLog(source, samples, reader.layout, reader.faults, reader.ahead)


def samples_of(
    log: Any, p: int | None, m: int | None, chosen: Mapping[str, str], source: str
) -> tuple[Samples, Layout]:
    """Return the samples of a DataFrame, of arrays by name, or of a file that is no CSV text.

    Args:
        log: the DataFrame, the arrays, or the path.
        p, m: numbers of readings and inputs that the plant has; None: as many as are named.
        chosen: columns that the user names; see `names.parse_columns`.
        source: the log, for messages.

    Raises:
        FileError: it cannot be read, or a column is uncertain.
    """
    columns = _columns(log)
    if not columns:
        raise FileError(f"{source}: holds no columns of numbers")
    titles = [title for title, _ in columns]
    values = np.column_stack([column for _, column in columns])
    seen = values if len(values) > 1 else None
    layout = layout_of_titles(titles, p, m, chosen, source, seen)
    used = values[:, layout.columns]
    used[np.abs(used) > LARGEST] = np.nan
    samples = split_signals(used, layout, np.arange(1, len(used) + 1))
    return oldest_first(samples._replace(t=to_seconds(samples.t, layout.seconds))), layout


def samples_of_arrays(
    given: Mapping[str, Any], p: int | None = None, m: int | None = None
) -> tuple[Samples, Layout]:
    """Return the samples of arrays.

    Args:
        given: times t (N) [s], the step [s] or None; readings y (N) or (N x p), NaN if one is
            missing; inputs u (N) or (N x m); perhaps a reference r (N) or None.
        p, m: numbers of readings and inputs that the plant has; None: as many as there are.

    Raises:
        InputError: arrays of different lengths, or not numeric.
    """
    arrays = {key: numbers(key, x, "iufb") for key, x in given.items() if x is not None}
    size = max(arrays["y"].shape, default=0)
    if "t" in arrays and arrays["t"].ndim == 0:
        arrays["t"] = arrays["t"] * np.arange(size)
    single = {arrays[key].size for key in ("t", "r") if key in arrays}
    if single - {size} or any(size not in x.shape or x.ndim > 2 for x in arrays.values()):
        shapes = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
        raise InputError(f"arrays: expected as many rows in each, one t, one r, found {shapes}")
    return samples_of(arrays, p, m, {}, "arrays")


def _columns(log: Any) -> Columns:
    """Return the columns of numbers of a file or a DataFrame."""
    if isinstance(log, dict):
        return _columns_of(log, "arrays")
    if not isinstance(log, Path):
        return of_frame(log)
    if log.suffix.lower() in JSON:
        return of_json(log)
    return of_npz(log) if log.suffix.lower() == ".npz" else of_mat(log)


def of_frame(frame: Any) -> Columns:
    """Return the numeric columns of a DataFrame; times of day become seconds since the first."""
    titled = [(str(title), np.asarray(frame[title])) for title in frame.columns]
    index = np.asarray(frame.index)
    unnamed = "time" if index.dtype.kind in "mM" else ""
    titled.insert(0, (str(frame.index.name or unnamed), index))
    return _columns_of_titles(titled)


def _columns_of_titles(titled: Iterable[tuple[str, Any]]) -> Columns:
    """Return those of titled arrays that hold numbers."""
    columns = [(split_unit(title), to_numbers(title, values)) for title, values in titled]
    return [(title, column) for title, column in columns if column.size]


def to_numbers(title: str, values: Any) -> Floats:
    """Return an array as numbers: times in seconds since the first, no entry of words.

    Args:
        title: of the column, for messages.
        values: of one type, of any shape; texts are read as the cells of a table.

    Raises:
        FileError: the type is another one, such as complex.
    """
    if values.dtype.kind == "M":
        values = values - np.fmin.reduce(values, axis=None)
    if values.dtype.kind == "m":
        values = values / np.timedelta64(1, "s")
    if values.dtype.kind in "OSU":
        found = numbers_of_texts(
            list(map(str, values.ravel().tolist())), lambda text: parse_cell(text, ".")
        )
        if not np.isfinite(found).any():
            return np.empty(0)
        values = found.reshape(values.shape)
    if values.dtype.kind not in "iufb":
        raise FileError(
            f"{title}: expected numbers or times, found {values.dtype}. Convert it, or leave it out"
        )
    return values.astype(float)


def of_npz(path: Path) -> Columns:
    """Return the arrays of an .npz file as columns. Raises FileError."""
    with convert_read_errors(path):
        arrays = load_arrays(path, LARGEST_RUN)
        arrays.pop("info", None)
    return _columns_of(arrays, path)


def of_json(path: Path) -> Columns:
    """Return the tables of a JSON document, or of JSON objects, one a line, as columns.

    Tables with the same titles are records of one log, one after another. Of different ones that
    with the most rows counts. Raises FileError.

    Args:
        path: the file. A key that an object lacks is a missing number.
    """
    with convert_read_errors(path):
        text = read_bytes(path, LARGEST_TABLE).decode()
    try:
        tree = json.loads(text)
    except (ValueError, RecursionError):
        tree = _read_json_lines(text, path)
    if isinstance(tree, dict) and not any(isinstance(one, dict | list) for one in tree.values()):
        tree = [tree]  # a single line
    tables: dict[tuple[str, ...], list[Floats]] = {}
    for titles, rows in _tables_of(tree):
        tables.setdefault(titles, []).append(rows)
    if not tables:
        raise FileError(
            f"{path}: holds no table: as many numbers in lists by name, objects with numbers, or "
            "a list by name of rows of numbers. Save its signals as columns of a .csv file"
        )
    titles, parts = max(tables.items(), key=lambda one: sum(map(len, one[1])))
    return list(zip(map(split_unit, titles), np.vstack(parts).T, strict=True))


def _read_json_lines(text: str, path: Path) -> list[Any]:
    """Return the JSON objects of a text, one a line. Raises FileError."""
    rows = []
    for k, line in enumerate(text.splitlines(), 1):
        try:
            row = json.loads(line) if line.strip() else {}
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            raise FileError(f"{path}: line {k}: expected a JSON object, found {line[:40]!r}")
        rows += [row] * bool(row)
    return rows


def _tables_of(tree: Any) -> Iterator[tuple[tuple[str, ...], Floats]]:
    """Yield the tables of a JSON document: titles (K), and rows of numbers (R x K).

    A table is a list of objects, several lists of one length by name, or a list by name of more
    rows of numbers than columns, whose titles are their numbers.
    """
    parts = [tree]
    for part in parts:
        if isinstance(part, dict):
            lists = {name: one for name, one in part.items() if isinstance(one, list)}
            for rows in filter(_is_matrix, lists.values()):
                titles = [str(k + 1) for k in range(len(rows[0]))]
                yield from _table(titles, zip(*rows, strict=True))
            longest = max(map(len, lists.values()), default=0)
            named = {name: one for name, one in lists.items() if len(one) == longest}
            yield from _table(named, named.values())
            parts += part.values()
        elif isinstance(part, list):
            objects = [one for one in part if isinstance(one, dict)]
            names = dict.fromkeys(itertools.chain.from_iterable(objects))
            yield from _table(names, ([one.get(name) for one in objects] for name in names))
            parts += [one for one in part if isinstance(one, dict | list)]


def _is_matrix(rows: list[Any]) -> bool:
    """Return whether rows of numbers have one width, which is less than their count."""
    if not all(isinstance(row, list) for row in rows):
        return False
    widths = set(map(len, rows))
    return len(widths) == 1 and 1 < min(widths) < len(rows)


def _table(
    titles: Iterable[str], columns: Iterable[Sequence[Any]]
) -> list[tuple[tuple[str, ...], Floats]]:
    """Return a table of the columns with numbers, times or their texts; [] with fewer than two."""
    known = {}
    for title, column in zip(titles, columns, strict=True):
        numbers = to_numbers(title, np.array(list(map(_cell_of, column)), "U"))
        if numbers.size:
            known[title] = numbers
    return [(tuple(known), np.column_stack([*known.values()]))] if len(known) > 1 else []


def _cell_of(value: Any) -> str:
    """Return a value of JSON as the text of a cell; "" of a list or an object."""
    return "" if isinstance(value, dict | list) else str(value)[:LONGEST_CELL]


def of_mat(path: Path) -> Columns:
    """Return the variables of a .mat file as columns. Raises FileError."""
    from scipy.io import loadmat, whosmat

    with convert_read_errors(path):
        content = read_bytes(path, LARGEST_TABLE)
        if is_matlab_73(content):
            return _columns_of(load_matlab_73(content, LARGEST_MATRICES), path)
        _require_small(content)
        declared = [entry for entry in whosmat(io.BytesIO(content)) if entry[2] in NUMERIC]
        if sum(math.prod(shape) for _, shape, _ in declared) > LARGEST_MATRICES:
            raise ValueError("its matrices are larger than any log")
        names = [name for name, _, _ in declared]
        file = io.BytesIO(content)
        arrays = loadmat(file, mat_dtype=True, variable_names=names) if names else {}
    named = {name: array for name, array in arrays.items() if not name.startswith("__")}
    return _columns_of(named, path)


def _require_small(content: bytes) -> None:
    """Raise ValueError for a .mat file whose compressed elements unpack to more than any log.

    A file of version 5 has a head of 128 bytes and then elements: four bytes of type, four of
    length. The lengths inside of an element may lie, so its unpacked bytes are counted.
    """
    order: Literal["little", "big"] = "little" if content[126:128] == b"IM" else "big"
    at = 128
    left = LARGEST_MATRICES
    while at + 8 <= len(content):
        kind = int.from_bytes(content[at : at + 4], order)
        length = int.from_bytes(content[at + 4 : at + 8], order)
        if kind == COMPRESSED:
            left -= unpacked_size(content[at + 8 : at + 8 + length], left)
        at += 8 + length
        if left <= 0:
            raise ValueError(f"it would unpack to more than {LARGEST_MATRICES / 1e6:,.0f} MB")


def _columns_of(arrays: dict[str, Any], path: Path | str) -> Columns:
    """Return arrays of one length as columns; a matrix gives `u[0]`, `u[1]`, ...

    Raises FileError.
    """
    usable = {
        name: np.atleast_2d(to_numbers(name, array))
        for name, array in arrays.items()
        if isinstance(array, np.ndarray) and array.ndim in (1, 2)
    }
    longest = max((max(array.shape) for array in usable.values()), default=0)
    columns: Columns = []
    for name, array in usable.items():
        rows = array if len(array) == longest else array.T
        names = [name] if rows.shape[1] == 1 else [f"{name}[{k}]" for k in range(rows.shape[1])]
        if len(rows) == longest:
            columns += [(Title(one, ""), x) for one, x in zip(names, rows.T, strict=True)]
    if not columns:
        raise FileError(f"{path}: holds no arrays of numbers. It should hold t, y and u")
    return columns
