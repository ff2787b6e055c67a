"""Loops of a plant: files of a folder, columns of a table, tags of a historian's long table."""

from __future__ import annotations

import contextlib
import functools
import itertools
import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from undeadzone.errors import FileError, InputError
from undeadzone.logs.kinds import split_unit
from undeadzone.logs.names import parse_columns
from undeadzone.logs.samples import FIRST
from undeadzone.logs.text import PREAMBLE, lines_ahead
from undeadzone.logs.whole import samples_of
from undeadzone_identify.logs.log import Log, log_from_samples, read_log
from undeadzone_identify.logs.tables import (
    Arrays,
    columns_of_files,
    columns_of_lines,
    names_times,
    numbers_of_columns,
    part_columns,
    read_lines,
    read_parquet,
    signals_of_columns,
)

# Words of a tag, its last or its first, with the signals that they may name, the likeliest first.
ROLES = {
    **dict.fromkeys(
        ("OP", "MV", "CO", "OUT", "OUTPUT", "CONTROLLER_OUTPUT", "LMN", "CVEU", "SORTIE", "SALIDA",
         "USCITA", "UITGANG", "STELLGRÖSSE", "STELLGRÖßE", "STELLWERT", "Y"), "u",
    ),
    **dict.fromkeys(
        ("PV", "PV_IN", "PV_OUT", "MEAS", "PROCESS", "PROCESS_VALUE", "PROCESS_VARIABLE", "MESURE",
         "MISURA", "MEETWAARDE", "ISTWERT", "REGELGRÖSSE", "REGELGRÖßE", "VALUE", "X"), "y",
    ),
    **dict.fromkeys(
        ("SP", "SV", "SPT", "WSP", "SP_INT", "SP_OUT", "SETPOINT", "SET_POINT", "SET", "CONSIGNE",
         "CONSIGNA", "SOLLWERT", "FÜHRUNGSGRÖSSE", "FÜHRUNGSGRÖßE", "W"), "r",
    ),
    "CV": "yu",  # controlled variable, or beside a PV the controller's
}  # fmt: skip
WEAK = {"X", "W", "Y", "VALUE", "OUTPUT"}  # words of other things too: two of them name no loop
_ROLE = "|".join(ROLES).replace("_", r"[\W_]")
TAGGED = re.compile(
    rf"(?i)(?:(.*?)(?:[\W_]|(?<=\d))({_ROLE})(?:\W(?:F_)?(?:CV|VALUE))?|({_ROLE})[\W_](.+))"
)
BLOCK = re.compile(r"[/\\.](AI|AO|PID|DACA|PIDA)\d*$")  # function blocks of one module
ENDINGS = (".csv", ".txt", ".tsv", ".xlsx", ".parquet")
Record = Path | Callable[[], Log]  # a file, or what builds the log of a table's columns
DAY = re.compile(r"(^|[-_. /])\d[\d_.\-T]*(?=/|$)")  # behind the name of a valve, or alone


def find_loops(source: Path) -> dict[str, list[Record]]:
    """Find the loops of a folder or a table: records of one valve stand together.

    Args:
        source: the folder, whose files or folders have the name of a valve, perhaps with a date or
            a number behind it; or a file.

    Returns:
        By the name of a valve its records, or their files.

    Raises:
        InputError: there are none.
    """
    if not source.is_dir():
        found = read_loops(source)
        return {tag: [one] for tag, one in found.items()} if found else {source.stem: [source]}
    loops: dict[str, list[Record]] = defaultdict(list)
    files: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(source.rglob("*")):
        if path.suffix.lower() in ENDINGS:
            several: dict[str, Record] = {}
            with contextlib.suppress(FileError):  # its record is refused
                several = read_loops(path)
            for tag, one in several.items():
                loops[tag].append(one)
            if not several:
                name = path.relative_to(source).with_suffix("").as_posix()
                files[DAY.sub("", name).strip("/") or path.stem].append(path)
    for tag, roles in _find_roles(files).items():
        signals = list[tuple[str, Path]]()
        for name in roles.values():
            signals += zip(itertools.repeat(name), files[name], strict=False)
        with contextlib.suppress(FileError):  # files that cannot be read are refused one by one
            arrays = signals_of_columns(*columns_of_files(signals)) or {}
            loops[tag] += _records_of(arrays, str(source)).values()
            for name in roles.values():
                del files[name]
    for name, paths in files.items():
        loops[name] += paths
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
    return _records_of(_read_arrays(path), str(path))


def _records_of(arrays: Arrays, source: str) -> dict[str, Record]:
    """Return by tag what builds the log of each loop of a table.

    Args:
        arrays: columns by name.
        source: of the table, for messages.
    """
    time = [*filter(names_times, arrays)][:1]
    return {
        tag.strip("/\\> "): functools.partial(
            _build_log,
            f"{source}, {tag}",
            {name: arrays[name] for name in (*time, *roles.values())},
            [*"t"[: len(time)], *roles],
        )
        for tag, roles in _find_roles(arrays).items()
    }


def _find_roles(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the columns of each loop by tag and signal.

    Args:
        names: of all columns.
    """
    tags: dict[str, dict[str, str]] = defaultdict(dict)
    for name in names:
        match = TAGGED.fullmatch(split_unit(name).name)
        if match and (match[1] or match[4]):
            word = re.sub(r"\W", "_", match[2] or match[3]).upper()
            tags[match[1] or match[4]][word] = name
    for tag in [*tags]:
        if BLOCK.search(tag) and not _choose_roles(tags[tag]):
            tags[BLOCK.sub("", tag)] |= tags[tag]
    return {tag: roles for tag, own in tags.items() if (roles := _choose_roles(own))}


def _choose_roles(own: dict[str, str]) -> dict[str, str]:
    """Return the columns of a tag by signal; empty where they name no loop.

    Args:
        own: columns by the words of `ROLES`.
    """
    roles: dict[str, str] = {}
    for word in sorted(own, key=lambda one: (one in WEAK, len(ROLES[one]))):
        signal = next(filter(lambda one: one not in roles, ROLES[word]), None)
        if signal is not None:
            roles[signal] = own[word]
    is_named = len(own) > 2 or not own.keys() <= WEAK
    return roles if is_named and {"u", "y"} <= roles.keys() else {}


def _build_log(source: str, arrays: Arrays, signals: list[str]) -> Log:
    """Return columns of a table as a log, as `read_log` has that of a file.

    Args:
        source: of the columns, for messages.
        arrays: columns by name.
        signals: of the columns: t, y, u, r.

    Raises:
        FileError: OP, PV or the time has no number that can be read.
    """
    chosen = parse_columns(",".join(map("{}={}".format, signals, itertools.count(1))))
    log = log_from_samples(*samples_of(arrays, None, None, chosen, source), source, strict=False)
    return log._replace(inputs=("OP",), outputs=("PV",))


def _read_arrays(path: Path) -> Arrays:
    """Return the columns of a table by name, a long one by its signals."""
    if path.suffix.lower() == ".parquet":
        return read_parquet(path)
    lines = read_lines(path)
    if not lines:
        raise FileError(f"{path}: no line with content")
    lines = lines[lines_ahead(lines[:PREAMBLE]) or 0 :]
    few = columns_of_lines([*lines[:FIRST], *lines[-FIRST:]])
    is_tagged = sum(bool(TAGGED.fullmatch(split_unit(one).name)) for one in few[0]) > 1
    if not is_tagged and not part_columns(*few)[-1]:
        return {}
    titles, columns = columns_of_lines(lines)
    if not is_tagged:
        return signals_of_columns(titles, columns) or {}
    numbers, times = numbers_of_columns(titles, columns)
    arrays = dict(zip(titles, numbers, strict=False))
    if times and not names_times(titles[times[0]]):
        titles[times[0]] = "t"
    return {titles[k]: numbers[k] for k in times[:1]} | arrays


def read_record(record: Record) -> Log:
    """Return a record of a loop.

    Args:
        record: file of it, or what builds it from a table.

    Raises:
        FileError: it cannot be read.
    """
    return read_log(record) if isinstance(record, Path) else record()


def read_log_or_loop(source: Any, columns: str | None, strict: bool) -> Log:
    """Return the log of a file: that of its one loop where tags name OP, PV and SP.

    Arguments and errors are those of `read_log`.
    """
    if columns is None and str(source).lower().endswith(ENDINGS):
        found = [*read_loops(Path(source)).values()]
        log = read_record(found[0]) if len(found) == 1 else None
        if log is not None and log.r.size:
            return log
    return read_log(source, columns, strict)
