"""The problem as a value: read from TOML, or built in Python from the same words."""

from __future__ import annotations

import math
import os
import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec

from undeadzone.arrays import Array, decode
from undeadzone.controllers import ControllerOptions
from undeadzone.ensemble import tuning, vary
from undeadzone.ensemble.tuning import Tune
from undeadzone.ensemble.vary import Vary
from undeadzone.errors import FileError, InputError
from undeadzone.explain import explain
from undeadzone.files import reason
from undeadzone.observers import ObserverOptions
from undeadzone.observers.claims import Claims
from undeadzone.plant import Plant
from undeadzone.region import Region
from undeadzone.sensor import Sensor
from undeadzone.signals import Disturbance, Signal


class Model(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What observer and controller believe of the plant; absent keys are the plant's."""

    A: Array | None = None
    B: Array | None = None
    C: Array | None = None
    parameters: dict[str, float] = {}


class Simulation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """duration [s]; time: continuous (RK4) or sampled (exact hold, discrete observer); step [s].

    seed: of every random number; substeps: RK4 steps within a sample, for a nonlinear plant in sampled time; switching,
    in continuous time: located (the change of side is found inside the step, which keeps the order) or plain RK4.
    order: 4 for RK4; 5 to 20 for Taylor series of that order, for loops that are linear on each side of the zone: much
    longer steps at the same accuracy.
    """

    duration: float = 20.0
    time: Literal["continuous", "sampled"] = "continuous"
    step: float = 1e-3
    seed: int = 0
    substeps: int = 10
    switching: Literal["located", "plain"] = "located"
    order: int = 4


class Units(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Names of units for labels and columns; numbers are never converted."""

    output: str = "1"
    input: str = "1"
    state: str | list[str] = "1"


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A plant behind a dead zone, what it should follow, and what watches and drives it.

    tracked: outputs that follow the reference (default: the first min(inputs, outputs)). ensemble: what varies among many runs. tune:
    what `undeadzone tune` may change, and to what end. declared: what the methods of `undeadzone arena` are told.
    compare: another observer, whose run `undeadzone run` shows beside the first. region: on which `undeadzone check` certifies a nonlinear model.
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
    ensemble: Vary | None = None
    tune: Tune | None = None
    declared: Claims | None = None
    compare: ObserverOptions | None = None
    region: Region | None = None
    title: str = "Untitled"


def read(path: str | os.PathLike[str]) -> Scenario:
    """The scenario in a TOML file. Raises FileError, InputError with the key, what was found and what to do."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise FileError(f"{path}: cannot read: not UTF-8 text") from None
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot read: {reason(error)}") from None
    return parse(text, Path(path).parent)


def parse(text: str, folder: Path = Path()) -> Scenario:
    """The scenario in a TOML text; paths in it are relative to `folder`. Raises InputError."""
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise InputError("not valid TOML: nested too deeply") from None
    except ValueError as error:
        raise InputError(f"not valid TOML: {error}") from None
    return convert(data, folder)


def convert(data: dict[str, Any], folder: Path = Path()) -> Scenario:
    """The scenario in a dictionary as TOML gives it. Raises InputError."""
    try:
        _require_finite(data, "")
        data = data | {kind.TABLE.name: kind.TABLE.decoded(data[kind.TABLE.name]) for kind in (vary, tuning) if kind.TABLE.name in data}
        scenario = msgspec.convert(data, Scenario, dec_hook=decode)
    except RecursionError:
        raise InputError("the tables are nested too deeply for a scenario") from None
    except msgspec.ValidationError as error:
        raise InputError(explain(str(error), data, Scenario)) from None
    return anchored(scenario, folder)


def anchored(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with the files that it names taken from `folder`."""
    plant = msgspec.structs.replace(scenario.plant, arm=_anchor(scenario.plant.arm, folder))
    parts = {part: _anchor(getattr(scenario, part), folder) for part in ("reference", "disturbance", "observer", "compare")}
    return msgspec.structs.replace(scenario, plant=plant, **parts)


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
        raise InputError(f"{key}: the whole number is too large")
