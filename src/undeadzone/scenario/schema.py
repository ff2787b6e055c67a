"""The problem as a value: read from TOML, or built in Python from the same words."""

from __future__ import annotations

from typing import Literal

import msgspec

from undeadzone.controllers import ControllerOptions
from undeadzone.observers import ObserverOptions
from undeadzone.observers.parts.claims import Claims
from undeadzone.plants.options import Plant
from undeadzone.plants.region import Region
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.tune_table import Tune
from undeadzone.sensor import Sensor
from undeadzone.signals.exosystem import Disturbance, Signal
from undeadzone.support.arrays import Array


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
