"""Scenarios from TOML: read, checked, with the files that they name found."""

from __future__ import annotations

import math
import os
import tomllib
from pathlib import Path
from typing import Any

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
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise FileError(f"{path}: cannot read: not UTF-8 text") from None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    return parse(text, Path(path).parent)


def parse(text: str, folder: Path = Path()) -> Scenario:
    """The scenario in a TOML text.

    Args:
        text: the text.
        folder: the files that it names are relative to it.

    Raises:
        InputError: with the key, what was found and what to do.
    """
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise InputError("not valid TOML: nested too deeply") from None
    except ValueError as error:
        raise InputError(f"not valid TOML: {error}") from None
    return convert(data, folder)


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
