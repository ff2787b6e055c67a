"""Loops of a plant: files of a folder, columns of a table, tags of a historian's long table."""

from __future__ import annotations

import functools
import re
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import split_unit, time_rank
from undeadzone.util.arrays import Floats, hold_last
from undeadzone_identify.logs.log import Log, log_from_arrays, read_log
from undeadzone_identify.logs.tables import (
    Arrays,
    columns_of_lines,
    numbers_of_columns,
    read_lines,
    read_parquet,
    signals_of_columns,
)

ROLES = {  # of the last word of a tag, or of its first
    **dict.fromkeys(("OP", "MV", "CO", "OUT", "OUTPUT", "STELLGRÖSSE", "STELLGRÖßE"), "u"),
    **dict.fromkeys(("PV", "CV", "MEAS", "PROCESS", "ISTWERT"), "y"),
    **dict.fromkeys(("SP", "SV", "SPT", "SETPOINT", "SET", "SOLLWERT"), "r"),
}
_ROLE = "|".join(ROLES)
TAGGED = re.compile(rf"(?i)(?:(.*?)(?:[\W_]|(?<=\d))({_ROLE})(?:\.CV|\.VALUE)?|({_ROLE})[\W_](.+))")
ENDINGS = (".csv", ".txt", ".tsv", ".parquet")
Record = Path | Callable[[], Log]  # a file, or what builds the log of a table's columns
DAY = re.compile(r"[-_. ]\d[\d_.\-T]*$")  # of a file's name, behind the name of its valve


def find_loops(source: Path) -> dict[str, list[Record]]:
    """Find the loops of a folder or a table: records of one valve stand together.

    Args:
        source: the folder, whose files have the name of a valve with a date or a number behind it,
            or a file.

    Returns:
        By the name of a valve its records, or their files.

    Raises:
        InputError: there are none.
    """
    if not source.is_dir():
        found = read_loops(source)
        return {tag: [one] for tag, one in found.items()} if found else {source.stem: [source]}
    loops: dict[str, list[Record]] = defaultdict(list)
    for path in sorted(source.rglob("*")):
        if path.suffix.lower() in ENDINGS:
            several = read_loops(path)
            for tag, one in several.items():
                loops[tag].append(one)
            if not several:
                loops[DAY.sub("", path.stem) or path.stem].append(path)
    if not loops:
        raise InputError(f"{source}: holds no tables ({', '.join(ENDINGS)})")
    return dict(loops)


def read_loops(path: Path) -> dict[str, Record]:
    """Read the loops of a table of tags, wide or long; empty if its columns name one loop.

    Args:
        path: of a file whose names are TAG.PV, TAG.MV and TAG.SV, or the like.

    Raises:
        FileError: it cannot be read.
    """
    arrays = _read_arrays(path)
    tags: dict[str, dict[str, str]] = defaultdict(dict)
    for name in arrays:
        match = TAGGED.fullmatch(split_unit(name).name)
        if match and (match[1] or match[4]):
            tags[match[1] or match[4]][ROLES[(match[2] or match[3]).upper()]] = name
    times = next((x for name, x in arrays.items() if time_rank(split_unit(name)) >= 0), None)
    return {
        tag.strip("/\\ "): functools.partial(
            _build_log,
            f"{path}, {tag}",
            times,
            {key: arrays[name] for key, name in roles.items()},
            split_unit(roles["y"]).unit,
        )
        for tag, roles in tags.items()
        if {"u", "y"} <= roles.keys()
    }


def _build_log(source: str, times: Floats | None, own: Arrays, unit: str) -> Log:
    """Return a loop's rows as a log, from the first known OP on, which is held as SP is.

    Raises FileError.
    """
    count = own["u"].size
    t = np.arange(count, dtype=float) if times is None else times
    u, r = (hold_last(own.get(key, np.empty(0)).reshape(count, -1)) for key in "ur")
    usable = np.isfinite(u[:, 0]) & np.isfinite(t)
    if not usable.any() or not np.isfinite(own["y"]).any():
        raise FileError(
            f"{source}: OP, PV or the time has no number that can be read (dates: 2026-04-03)"
        )
    t, first = np.unique(t[usable], return_index=True)
    u, y, r = (x[usable][first] for x in (u, own["y"], r))
    log = log_from_arrays(t - t[0], u, y)
    return log._replace(
        inputs=("OP",), outputs=("PV",), output_units=(unit or "1",), source=source, r=r,
        counted=times is None,
    )  # fmt: skip


def _read_arrays(path: Path) -> Arrays:
    """Return the columns of a table by name, a long one by its signals."""
    if path.suffix.lower() == ".parquet":
        return read_parquet(path)
    lines = read_lines(path)
    if not any(map(TAGGED.search, lines)):
        return {}
    titles, columns = columns_of_lines(lines)
    named = list(map(split_unit, titles))
    if sum(bool(TAGGED.fullmatch(one.name)) for one in named) < 2:
        return signals_of_columns(titles, columns) or {}
    numbers, times = numbers_of_columns(titles, columns)
    first = dict(zip("t", [numbers[k] for k in times[:1]], strict=False))
    return first | dict(zip(titles, numbers, strict=False)) | first


def read_record(record: Record) -> Log:
    """Return a record of a loop.

    Args:
        record: file of it, or what builds it from a table.

    Raises:
        FileError: it cannot be read.
    """
    return read_log(record) if isinstance(record, Path) else record()
