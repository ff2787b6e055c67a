"""Loops of a plant: files of a folder, columns of a table, tags of a historian's long table."""

from __future__ import annotations

import functools
import re
from collections import defaultdict
from pathlib import Path

import numpy as np

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import Title, split_unit, time_rank
from undeadzone.logs.samples import FIRST, numbers_of_texts
from undeadzone.logs.stamps import stamps_of
from undeadzone.logs.text import dialect_of, parse_cell
from undeadzone.util.arrays import Floats
from undeadzone_identify.logs.log import Log, log_from_arrays, read_log
from undeadzone_identify.logs.tables import (
    Arrays,
    columns_of_lines,
    read_lines,
    read_parquet,
    signals_of_lines,
)

ROLES = {  # of the last word of a tag, or of its first
    **dict.fromkeys(("OP", "MV", "CO", "OUT", "OUTPUT"), "u"),
    **dict.fromkeys(("PV", "CV", "MEAS", "PROCESS"), "y"),
    **dict.fromkeys(("SP", "SV", "SETPOINT", "SET"), "r"),
}
_ROLE = "|".join(ROLES)
TAGGED = re.compile(rf"(?i)(?:(.*?)(?:[\W_]|(?<=\d))({_ROLE})(?:\.CV)?|({_ROLE})[\W_](.+))")
ENDINGS = (".csv", ".txt", ".tsv", ".parquet")
DAY = re.compile(r"[-_. ]\d[\d_.\-T]*$")  # of a file's name, behind the name of its valve


def find_loops(source: Path) -> dict[str, list[Log | Path]]:
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
        return {tag: [log] for tag, log in found.items()} if found else {source.stem: [source]}
    loops: dict[str, list[Log | Path]] = defaultdict(list)
    for path in sorted(source.rglob("*")):
        if path.suffix.lower() in ENDINGS:
            several = read_loops(path)
            for tag, log in several.items():
                loops[tag].append(log)
            if not several:
                loops[DAY.sub("", path.stem) or path.stem].append(path)
    if not loops:
        raise InputError(f"{source}: holds no tables ({', '.join(ENDINGS)})")
    return dict(loops)


def read_loops(path: Path) -> dict[str, Log]:
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
    loops = {tag.strip("/\\ "): one for tag, one in tags.items() if {"u", "y"} <= one.keys()}
    if not loops:
        return {}
    times = next((x for name, x in arrays.items() if time_rank(split_unit(name)) >= 0), None)
    logs = {}
    for tag, roles in loops.items():
        own = {key: arrays[name] for key, name in roles.items()}
        logs[tag] = _build_log(
            f"{path}, {tag}", times, own, [Title(tag, ""), split_unit(roles["y"])]
        )
    return logs


def _build_log(source: str, times: Floats | None, own: Arrays, titles: list[Title]) -> Log:
    """Return a loop's rows as a log, from the first known OP on, which is held."""
    usable = np.isfinite(own["u"]) & (True if times is None else np.isfinite(times))
    if not usable.any() or not np.isfinite(own["y"]).any():
        raise FileError(f"{source}: OP or PV holds no number")
    t = np.arange(usable.size, dtype=float) if times is None else times
    t, first = np.unique(t[usable], return_index=True)
    u, y, r = (own.get(key, np.empty((usable.size, 0)))[usable][first] for key in "uyr")
    log = log_from_arrays(t - t[0], u, y)
    return log._replace(
        inputs=("OP",), outputs=("PV",), output_units=(titles[1].unit or "1",), source=source,
        r=r.reshape(t.size, -1), counted=times is None,
    )  # fmt: skip


def _read_arrays(path: Path) -> Arrays:
    """Return the columns of a table by name, a long one by its signals."""
    if path.suffix.lower() == ".parquet":
        return read_parquet(path)
    lines = read_lines(path)
    if not lines:
        return {}
    dialect = dialect_of(lines[:FIRST])
    if not any(TAGGED.search(line) for line in lines[:FIRST]):
        return {}
    if not dialect.titles or sum(bool(TAGGED.fullmatch(one.name)) for one in dialect.titles) < 2:
        return signals_of_lines(lines) or {}
    titles, columns = columns_of_lines(lines)
    arrays = {}
    for title, cells in zip(titles, columns, strict=True):
        mark = dialect.mark if stamps_of(cells[:FIRST]) is None else "."
        arrays[title] = numbers_of_texts(cells, functools.partial(parse_cell, mark=mark))
    return arrays


def read_record(record: Log | Path) -> Log:
    """Return a record of a loop, read if it is in a file.

    Args:
        record: a log, or its file.
    """
    return record if isinstance(record, Log) else read_log(record)
