"""The problem as a value: read from TOML, or built in Python from the same words."""

from __future__ import annotations

import difflib
import math
import os
import re
import tomllib
import typing
from pathlib import Path
from typing import Any, Literal

import msgspec

from undeadzone.arrays import Array, decode
from undeadzone.controllers import ControllerOptions
from undeadzone.errors import FileError, InputError
from undeadzone.observers import ObserverOptions
from undeadzone.plant import Plant
from undeadzone.sensor import Sensor
from undeadzone.signals import Disturbance, Signal


class Model(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What observer and controller believe of the plant; absent keys are the plant's."""

    A: Array | None = None
    B: Array | None = None
    C: Array | None = None
    parameters: dict[str, float] = {}


class Simulation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """duration [s]; time: continuous (RK4 with located switching) or sampled (exact hold, discrete observer); step [s].

    seed: of every random number; substeps: RK4 steps within a sample, for a nonlinear plant in sampled time.
    """

    duration: float = 20.0
    time: Literal["continuous", "sampled"] = "continuous"
    step: float = 1e-3
    seed: int = 0
    substeps: int = 10


class Units(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Names of units for labels and columns; numbers are never converted."""

    output: str = "1"
    input: str = "1"
    state: str | list[str] = "1"


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A plant behind a dead zone, what it should follow, and what watches and drives it.

    tracked: outputs that follow the reference (default: the first min(inputs, outputs)).
    """

    plant: Plant
    sensor: Sensor
    reference: Signal
    observer: ObserverOptions
    controller: ControllerOptions
    simulation: Simulation = Simulation()
    model: Model | None = None
    disturbance: Disturbance | None = None
    tracked: list[int] | None = None
    units: Units = Units()
    title: str = "Untitled"


def read(path: str | os.PathLike[str]) -> Scenario:
    """The scenario in a TOML file. Raises FileError, InputError with the key, what was found and what to do."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot read: {os.strerror(error.errno) if error.errno else error}") from None
    except UnicodeDecodeError:
        raise FileError(f"{path}: cannot read: not UTF-8 text") from None
    return parse(text, Path(path).parent)


def parse(text: str, folder: Path = Path()) -> Scenario:
    """The scenario in a TOML text; paths in it are relative to `folder`. Raises InputError."""
    try:
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}") from None
    return convert(data, folder)


def convert(data: dict[str, Any], folder: Path = Path()) -> Scenario:
    """The scenario in a dictionary as TOML gives it. Raises InputError."""
    _require_finite(data, "")
    try:
        scenario = msgspec.convert(data, Scenario, dec_hook=decode)
    except msgspec.ValidationError as error:
        raise InputError(_explain(str(error), data)) from None
    return msgspec.structs.replace(scenario, **{part: _anchor(getattr(scenario, part), folder) for part in ("reference", "disturbance", "observer")})


def _anchor(part: Any, folder: Path) -> Any:
    """The part with the file that it names, if any, taken from `folder`."""
    paths = {name: str(folder / path) for name in ("path", "design") if (path := getattr(part, name, None)) is not None}
    return msgspec.structs.replace(part, **paths) if paths else part


def _require_finite(value: Any, key: str) -> None:
    if isinstance(value, dict):
        for name, child in value.items():
            _require_finite(child, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for index, child in enumerate(value):
            _require_finite(child, f"{key}[{index}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{key}: must be a finite number, found {value}")
    elif isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{key}: the number is too large")


def _explain(message: str, data: dict[str, Any]) -> str:
    """msgspec's message with the key first, and a suggestion where a key or choice is unknown."""
    body, _, path = message.partition(" - at `$")
    key = path.rstrip("`").lstrip(".")
    prefix = f"{key}: " if key else ""
    if found := re.match(r"Object contains unknown field `(.*)`", body):
        name, known = found[1], _fields(key, data)
        near = difflib.get_close_matches(name, known, 1)
        advice = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(sorted(known))}"
        return f"{key + '.' if key else ''}{name}: unknown key; {advice}"
    if found := re.match(r"Object missing required field `(.*)`", body):
        choices = f" (one of {', '.join(_tags(key))})" if found[1] in ("kind", "method") and _tags(key) else ""
        return f"{key + '.' if key else ''}{found[1]}: missing; this key is required{choices}"
    if (found := re.match(r"Invalid value '(.*)'", body)) and _tags(key.rpartition(".")[0]):
        known = _tags(key.rpartition(".")[0])
        near = difflib.get_close_matches(found[1], known, 1)
        advice = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
        return f"{prefix}unknown choice {found[1]!r}; {advice}"
    words = {
        "`object`": "a table",
        "`array`": "a list",
        "`float`": "a number",
        "`int`": "a whole number",
        "`str`": "text",
        "`bool`": "true or false",
        "`null`": "nothing",
    }
    for word, plain in words.items():
        body = body.replace(word, plain)
    return prefix + body[:1].lower() + body[1:]


def _structs(annotation: Any) -> list[type[msgspec.Struct]]:
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    return [found for part in typing.get_args(annotation) for found in _structs(part)]


def _at(key: str) -> list[type[msgspec.Struct]]:
    """The structs that may stand at a dotted key."""
    here: list[type[msgspec.Struct]] = [Scenario]
    for part in filter(None, re.split(r"[.\[]", re.sub(r"\[[^\]]*\]", "", key))):
        here = [found for struct in here for found in _structs(typing.get_type_hints(struct).get(part))]
    return here


def _tags(key: str) -> list[str]:
    return [str(struct.__struct_config__.tag) for struct in _at(key) if struct.__struct_config__.tag is not None]


def _fields(key: str, data: dict[str, Any]) -> list[str]:
    """Keys known at a dotted key, of the variant that the data choose where there are several."""
    here: Any = data
    for part in filter(None, re.findall(r"[^.\[\]]+", key)):
        here = here[int(part)] if isinstance(here, list) and part.isdigit() else here.get(part, {}) if isinstance(here, dict) else {}
    structs = _at(key)
    chosen = [s for s in structs if isinstance(here, dict) and s.__struct_config__.tag in (here.get("kind"), here.get("method"))] or structs
    names = [field for struct in chosen for field in struct.__struct_fields__]
    return names + [str(s.__struct_config__.tag_field) for s in chosen if s.__struct_config__.tag is not None]
