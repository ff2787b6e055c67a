"""Scenarios from TOML: read, checked, with the files that they name found.

For a text that is not TOML, the error contains the line and a correct form of it.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import msgspec

from undeadzone.errors import FileError, InputError
from undeadzone.plants.options import ALONE
from undeadzone.registry import decode_field
from undeadzone.scenario.address import alike, require_finite, with_entries
from undeadzone.scenario.messages import explain
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import parse_matlab_matrix
from undeadzone.util.files import (
    LARGEST_TABLE,
    convert_read_errors,
    read_bytes,
    read_table,
    read_text,
    to_path,
)
from undeadzone.util.toml import require_short_keys

FILE_KEYS: Final = ("path", "design")  # of a table, which name a file that is read
HABITS: Final = read_table(__file__)["habits"]
OPEN = r"^\s*([\w.]+)\s*=\s*\[\s*[-+.\de]+(\s+[-+.\de]+)+\s*(#.*|%.*)?$"  # A = [0 1


def read(path: str | os.PathLike[str], confine: str | os.PathLike[str] | None = None) -> Scenario:
    """Return the scenario in a TOML file.

    Args:
        path: the file. The files that it names are relative to its folder.
        confine: a folder outside of which it may name no file, for a stranger's scenario (None:
            any).

    Returns:
        The scenario, its keys and types checked.

    Raises:
        FileError: the file cannot be read.
        InputError: with the key, the value found and the remedy, also for a file outside of
            `confine`.

    Example:
        >>> path = folder / "mine.toml"
        >>> _ = path.write_text('''
        ... plant = { A = [[0, 1], [-1, -2]], B = [0, 1], C = [1, 0] }
        ... sensor = { right = 1.0, left = 0.6 }
        ... observer = { method = "auto", right = [0.0, 2.0] }
        ... reference = { kind = "sine", amplitude = 5.0, frequency = 0.2 }
        ... ''')
        >>> float(uz.read(path).sensor.right)
        1.0

    See Also:
        Scenario, simulate
    """
    path = to_path(path)
    with _naming(path):
        scenario = parse(_text(path), path.parent)
    return scenario if confine is None else confine_files(scenario, Path(confine))


def read_for_logs(
    path: str | os.PathLike[str], confine: str | os.PathLike[str] | None = None
) -> Scenario:
    """Return the scenario in a TOML file of which only plant, sensor and observer are used, along a
    log.

    Reference, controller and the sensor's widths may be left out. Others stand in for them.

    Args:
        path: the file. The files that it names are relative to its folder.
        confine: as of `read`.

    Raises:
        FileError: the file cannot be read.
        InputError: with the key, the value found and the remedy.
    """
    path = to_path(path)
    with _naming(path):
        scenario = convert(_complete_tables(_tables(_text(path))), path.parent)
    return scenario if confine is None else confine_files(scenario, Path(confine))


def _complete_tables(data: dict[str, Any]) -> dict[str, Any]:
    """Return the tables with the entries that logs do not need. Raises InputError."""
    for name, table in _STAND_INS.items():
        data.setdefault(name, table)
    sensor = data.setdefault("sensor", {})
    observer = data.get("observer")
    method = observer.get("method") if isinstance(observer, dict) else None
    if isinstance(sensor, dict):
        for width in ("right", "left"):
            if width not in sensor and method in _KNOW_THE_WIDTHS:
                raise InputError(
                    f"sensor.{width}: missing: observer.method {method!r} needs the true widths"
                )
        if observer is None and "right" not in sensor and "declared" not in data:
            raise InputError(
                "observer: missing. Name one and the range of the widths, such as "
                'observer = { method = "auto", right = [0.0, 2.0] }'
            )
        data["sensor"] = {"right": 0.0, "left": 0.0} | sensor
    return data


# Defaults for tables that a scenario for logs leaves out.
_STAND_INS: Final = {
    "reference": {"kind": "sine", "amplitude": 0.0, "frequency": 1e-6},
    "controller": {"method": "pd"},
}
_OTHER_FILES: Final = {  # files given in place of a scenario, and their right command
    ".csv": ". A log goes to undeadzone identify, or, behind the scenario, to estimate",
    ".npz": "; a run of an ensemble is shown by replay=NUMBER",
    ".py": ". Run a program with python",
    ".urdf": "; undeadzone arm shows a robot, and writes a scenario for it",
    ".json": ". A scenario is a TOML file: undeadzone init mine.toml",
    ".yaml": ". A scenario is a TOML file: undeadzone init mine.toml",
    ".m": ". A scenario is a TOML file: undeadzone init mine.toml",
}
_KNOW_THE_WIDTHS: Final = ("oracle", "full_state")  # methods that take the sensor's own widths


def _text(path: Path) -> str:
    """Return the text of a file. Raises FileError."""
    with convert_read_errors(path):
        return read_text(path)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Provide a context that puts the name of a file in front of errors in its text."""
    try:
        yield
    except FileError:
        raise
    except InputError as error:
        hint = _OTHER_FILES.get(path.suffix.lower(), "")
        raise type(error)(f"{path}: {error}{hint}") from None


def parse(text: str, folder: Path = Path()) -> Scenario:
    """Return the scenario in a TOML text.

    Args:
        text: the text.
        folder: the files that it names are relative to it.

    Raises:
        InputError: with the key, the value found and the remedy.
    """
    return convert(_tables(text), folder)


def _tables(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text. Raises InputError."""
    try:
        return tomllib.loads(require_short_keys(text))
    except InputError:
        raise
    except RecursionError:
        raise InputError("not valid TOML: nested too deeply") from None
    except ValueError as error:
        raise InputError(invalid_toml(text, str(error))) from None


def convert(data: dict[str, Any], folder: Path = Path()) -> Scenario:
    """Return the scenario in a dictionary as TOML gives it.

    Args:
        data: the tables.
        folder: the files that it names are relative to it.

    Raises:
        InputError: with the key, the value found and the remedy.
    """
    try:
        require_finite(data, "")
        data = with_entries(data)
        plant = data.get("plant")
        if isinstance(plant, dict) and any(plant.get(form) is not None for form in ALONE):
            data = _complete_tables(data)
        if "compare" in data:
            data["compare"] = alike(data["compare"], data.get("observer"))
        scenario = msgspec.convert(data, Scenario, dec_hook=decode_field)
    except RecursionError:
        raise InputError("the tables are nested too deeply for a scenario") from None
    except msgspec.ValidationError as error:
        raise InputError(explain(str(error), data, Scenario)) from None
    return anchor_files(scenario, folder)


def anchor_files(scenario: Scenario, folder: Path) -> Scenario:
    """Return the scenario with the files that it names taken from `folder`."""
    return _with_files(scenario, lambda key, path: str(folder / path))


def confine_files(scenario: Scenario, folder: Path) -> Scenario:
    """Return the scenario with the real paths of the files that it names, links followed.

    Args:
        scenario: with its files' paths.
        folder: that must hold them.

    Raises:
        InputError: for a file outside of `folder`. The message does not show if the file exists.
    """
    root = Path(os.path.realpath(folder))

    def confine_path(key: str, path: str) -> str:
        if "\0" in path:
            raise InputError(f"{key}: no path: it holds a NUL character. Take it out")
        real = Path(os.path.realpath(path))
        if _has_further_names(real):
            raise InputError(
                f"{key}: the file has further names, maybe outside of {folder}. Copy it there"
            )
        if not real.is_relative_to(root):
            raise InputError(
                f"{key}: names a file outside of {folder}, the only folder that is read"
            )
        return str(real)

    return _with_files(scenario, confine_path)


def _has_further_names(path: Path) -> bool:
    """Return whether a file is one that hard links show elsewhere too."""
    try:
        status = path.stat()
    except OSError:
        return False
    return stat.S_ISREG(status.st_mode) and status.st_nlink > 1


def digests(scenario: Scenario) -> dict[str, str]:
    """Return digests of the files that a scenario names, by key, without missing files."""
    by_key: dict[str, str] = {}

    def record_digest(key: str, path: str) -> str:
        with suppress(OSError, ValueError):
            content = read_bytes(path, LARGEST_TABLE)
            by_key[key] = hashlib.blake2b(content, digest_size=16).hexdigest()
        return path

    _with_files(scenario, record_digest)
    return by_key


def _with_files(scenario: Scenario, change: Callable[[str, str], str]) -> Scenario:
    """Return the scenario with other paths of the files that it names.

    Args:
        scenario: the scenario.
        change: takes a key and the path there, returns another path.
    """
    arm = _with_file(scenario.plant.arm, "plant.arm", change)
    parts: dict[str, Any] = {"plant": msgspec.structs.replace(scenario.plant, arm=arm)}
    for name in ("reference", "disturbance", "observer", "compare"):
        parts[name] = _with_file(getattr(scenario, name), name, change)
    return msgspec.structs.replace(scenario, **parts)


def _with_file(part: Any, key: str, change: Callable[[str, str], str]) -> Any:
    """Return the part under a key with another path of the file that it names, if any."""
    for name in FILE_KEYS:
        path = getattr(part, name, None)
        if path is not None:
            part = msgspec.structs.replace(part, **{name: change(f"{key}.{name}", path)})
    return part


def invalid_toml(text: str, message: str) -> str:
    """Return the message about a text that is not TOML, with its line.

    Args:
        text: that was read.
        message: of tomllib.
    """
    problem, _, where = message.partition(" (at ")
    place = re.match(r"line (\d+), column (\d+)", where)
    if place is None:
        return f"not valid TOML: {message}"
    number = int(place[1])
    lines = text.splitlines()
    line = lines[number - 1].strip() if number <= len(lines) else ""
    full = f"line {number}, column {place[2]}: not valid TOML: {problem[:1].lower()}{problem[1:]}"
    if line:
        full += f" in {line!r:.80}"
    return full + (_as_lists(line) or _habit(line))


def _as_lists(line: str) -> str:
    """Return the TOML form of a line in MATLAB's notation, `A = [0 1; -1 -2]`, else ""."""
    assignment = re.match(r"\s*([\w.]+)\s*=\s*(\[[^\[\]\"=]*\])\s*;?\s*(#.*|%.*)?$", line)
    if assignment is None:
        return ""
    try:
        rows = parse_matlab_matrix(assignment[2])
    except ValueError:
        return ""
    listed = [f"[{', '.join(f'{entry:g}' for entry in row)}]" for row in rows]
    return f"; write {assignment[1]} = [{', '.join(listed)}], or put MATLAB's matrix in quotes"


def _habit(line: str) -> str:
    """Return the correct form of a known wrong habit in a line, "" if no habit is found."""
    if re.match(OPEN, line):
        return ". Write [[0, 1], [-1, -2]]: rows in brackets, commas between numbers"
    for pattern, advice in HABITS:
        if re.search(pattern, line):
            return f"; {advice}"
    return ""
