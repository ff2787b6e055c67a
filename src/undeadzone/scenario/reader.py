"""Scenarios from TOML: read, checked, with the files that they name found."""

from __future__ import annotations

import math
import os
import tomllib
from pathlib import Path
from typing import Any, Final

import msgspec

from undeadzone.errors import FileError, InputError
from undeadzone.scenario import ensemble_table as vary
from undeadzone.scenario import tune_table as tuning
from undeadzone.scenario.messages import explain
from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import decode
from undeadzone.support.files import reason


def read(path: str | os.PathLike[str]) -> Scenario:
    """The scenario in a TOML file.

    Args:
        path: the file; the files that it names are relative to its folder.

    Returns:
        The scenario, its keys and types checked.

    Raises:
        FileError: the file cannot be read.
        InputError: with the key, what was found and what to do.
    """
    return parse(_text(path), Path(path).parent)


def read_for_logs(path: str | os.PathLike[str]) -> Scenario:
    """The scenario in a TOML file of which only plant, sensor and observer are used, along a log.

    Reference, controller and the sensor's widths may be left out; others stand in for them.

    Args:
        path: the file; the files that it names are relative to its folder.

    Raises:
        FileError: the file cannot be read.
        InputError: with the key, what was found and what to do.
    """
    data = _tables(_text(path))
    for name, table in _STAND_INS.items():
        data.setdefault(name, table)
    sensor, observer = data.setdefault("sensor", {}), data.get("observer")
    method = observer.get("method") if isinstance(observer, dict) else None
    if isinstance(sensor, dict):
        for width in ("right", "left"):
            if width not in sensor and method in _TOLD_THE_WIDTHS:
                raise InputError(
                    f"sensor.{width}: missing; observer.method {method!r} is told the true widths"
                )
        data["sensor"] = {"right": 0.0, "left": 0.0} | sensor
    return convert(data, Path(path).parent)


# What stands for tables that a scenario for logs leaves out.
_STAND_INS: Final = {
    "reference": {"kind": "sine", "amplitude": 0.0, "frequency": 1.0},
    "controller": {"method": "pd"},
}
_TOLD_THE_WIDTHS: Final = ("oracle", "full_state")  # methods that take the sensor's own widths


def _text(path: str | os.PathLike[str]) -> str:
    """The text of a file. Raises FileError."""
    try:
        return Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise FileError(f"{path}: cannot read: not UTF-8 text") from None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None


def parse(text: str, folder: Path = Path()) -> Scenario:
    """The scenario in a TOML text.

    Args:
        text: the text.
        folder: the files that it names are relative to it.

    Raises:
        InputError: with the key, what was found and what to do.
    """
    return convert(_tables(text), folder)


def _tables(text: str) -> dict[str, Any]:
    """The tables of a TOML text. Raises InputError."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise InputError("not valid TOML: nested too deeply") from None
    except ValueError as error:
        raise InputError(f"not valid TOML: {error}") from None


def convert(data: dict[str, Any], folder: Path = Path()) -> Scenario:
    """The scenario in a dictionary as TOML gives it.

    Args:
        data: the tables.
        folder: the files that it names are relative to it.

    Raises:
        InputError: with the key, what was found and what to do.
    """
    try:
        _require_finite(data, "")
        data = dict(data)
        for table in (vary.TABLE, tuning.TABLE):
            if table.name in data:
                data[table.name] = table.decoded(data[table.name])
        scenario = msgspec.convert(data, Scenario, dec_hook=decode)
    except RecursionError:
        raise InputError("the tables are nested too deeply for a scenario") from None
    except msgspec.ValidationError as error:
        raise InputError(explain(str(error), data, Scenario)) from None
    return anchored(scenario, folder)


def anchored(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with the files that it names taken from `folder`."""
    plant = msgspec.structs.replace(scenario.plant, arm=_anchor(scenario.plant.arm, folder))
    parts = {
        part: _anchor(getattr(scenario, part), folder)
        for part in ("reference", "disturbance", "observer", "compare")
    }
    return msgspec.structs.replace(scenario, plant=plant, **parts)


def _anchor(part: Any, folder: Path) -> Any:
    """The part with the file that it names, if any, taken from `folder`."""
    for name in ("path", "design"):
        path = getattr(part, name, None)
        if path is not None:
            part = msgspec.structs.replace(part, **{name: str(folder / path)})
    return part


def _require_finite(value: Any, key: str) -> None:
    """Raise InputError where a number at or below a key is not finite, or too large."""
    if isinstance(value, dict):
        for name, child in value.items():
            _require_finite(child, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, child in enumerate(value):
            _require_finite(child, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{key}: must be a finite number, found {value}")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{key}: the whole number is too large")
