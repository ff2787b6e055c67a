"""The problem as a value: read from TOML, or built in Python from the same words.

Parts that are made in Python are checked as those of a file are. A scenario that names no observer
or controller has the usual one (docs/decisions.md).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.actuator import Actuator, ActuatorModel
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers.filtering.prior import Assumptions
from undeadzone.plants.options import ElasticJoint, Plant
from undeadzone.plants.region import Region
from undeadzone.registry import (
    CONTROLLERS,
    OBSERVERS,
    CompensatorOptions,
    ControllerOptions,
    ObserverOptions,
)
from undeadzone.scenario.address import with_tables, with_value
from undeadzone.scenario.ensemble_table import Vary
from undeadzone.scenario.messages import require_kind
from undeadzone.scenario.operating_point import OperatingPoint
from undeadzone.scenario.tune_table import Tune
from undeadzone.signals.exosystem import Disturbance, Signal
from undeadzone.util import shown, toml
from undeadzone.util.arrays import Array, require_array
from undeadzone.util.files import SCHEMA, write_text
from undeadzone.util.toml import OptionTable

VAGUE: Final = 3.0  # in largest widths: upper end of the default range of the widths
SMALL: Final = 0.01  # least half of a gap of gears, if its range is not declared [rad]
BANDWIDTH: Final = 10.0  # of a rigid arm [rad/s]
UNNAMED: Final[Any] = None  # stands for an observer or a controller until the usual one does


def vague_assumptions(sensor: Sensor) -> Assumptions:
    """Return the assumption that the widths lie between 0 and `VAGUE` times the largest, alone."""
    widths = np.concatenate([np.ravel(sensor.right), np.ravel(sensor.left)])
    largest = float(widths[np.isfinite(widths)].max(initial=0.0))
    return Assumptions(right=[0.0, VAGUE * (largest or 1.0)])


def usual_observer(plant: Plant, sensor: Sensor, declared: Assumptions | None) -> ObserverOptions:
    """Return `auto` with the declared assumptions, or `contact` for an arm with gears.

    Args:
        plant: the plant, whose gaps count if it has gears.
        sensor: the dead zone, whose widths count if nothing is declared.
        declared: the declared assumptions of the scenario.
    """
    gears = getattr(plant.arm, "gears", None)
    if gears is not None:
        return OBSERVERS.create_options(
            "contact", half=[0.0, VAGUE * max(float(np.max(gears.half)), SMALL)]
        )
    assumptions = vague_assumptions(sensor) if declared is None else declared
    return OBSERVERS.create_options("auto", **assumptions.claims())


def usual_controller(plant: Plant, sampled: bool) -> ControllerOptions:
    """Return the default controller for this kind of plant: its options do not depend on units.

    Args:
        plant: the plant.
        sampled: whether time is sampled.
    """
    if plant.arm is None:
        return CONTROLLERS.create_options("state_feedback")
    if not isinstance(plant.arm, ElasticJoint):
        return CONTROLLERS.create_options("computed_torque", bandwidth=BANDWIDTH)
    return CONTROLLERS.create_options("lqr" if sampled else "state_feedback")


class Model(OptionTable, frozen=True, kw_only=True):
    """The plant as observer and controller know it. Absent keys are the plant's.

    Example:
        >>> uz.Model(A=[[0, 1], [-1, -1.9]]).A
        [[0, 1], [-1, -1.9]]

    See Also:
        Plant, Scenario

    Attributes:
        A: as in [plant] (n x n) (of a linear plant only).
        B: as in [plant] (n x m) (of a linear plant only).
        C: as in [plant] (p x n) (of a linear plant only).
        parameters: numbers of a nonlinear plant, by name.
        actuator: as in [actuator] (widths that are ranges are estimated).
        load_friction: as in [sensor]. A pair is a range, and `kalman`, `censored` and `auto` then
            estimate it [u].
        play: as in [sensor] (ranges [[lo, hi], [lo, hi]] in place of [c_r, c_l] are estimated by
            `kalman`, `censored` and `auto` [z]).
        delay: as in [plant].
    """

    A: Array | None = None
    B: Array | None = None
    C: Array | None = None
    parameters: dict[str, float] = {}
    actuator: ActuatorModel | None = None
    load_friction: Array | None = None
    play: Array | None = None
    delay: int | None = None


class Simulation(OptionTable, frozen=True, kw_only=True):
    """Duration of a run, and the method of its computation.

    Example:
        >>> simulation = uz.Simulation(time="sampled", step=0.01, duration=10.0)
        >>> simulation.step
        0.01

    See Also:
        Scenario, simulate

    Attributes:
        duration: length of the run [s].
        time: continuous (RK4) or sampled (exact hold, discrete observer).
        step: step of the integration, or time between samples [s].
        seed: seed of every random number.
        substeps: RK4 steps within a sample, for a nonlinear plant in sampled time.
        switching: how a change of side is met in continuous time: located (it is found inside the
            step, which keeps the order) or plain (RK4 alone).
        order: 4 for RK4 (5 to 20 for Taylor series of that order, for loops that are linear on each
            side of the zone: much longer steps at the same accuracy).
    """

    duration: float = 20.0
    time: Literal["continuous", "sampled"] = "continuous"
    step: float = 1e-3
    seed: int = 0
    substeps: int = 10
    switching: Literal["located", "plain"] = "located"
    order: int = 4


class Units(OptionTable, frozen=True, kw_only=True):
    """Names of units for labels and columns. Numbers are never converted.

    Example:
        >>> uz.Units(output="rad", input="V").output
        'rad'

    See Also:
        Scenario

    Attributes:
        output: unit of z and of the reference.
        input: unit of u.
        state: unit of the states, one for all or one per state.
    """

    output: str = "1"
    input: str = "1"
    state: str | list[str] = "1"


class Scenario(OptionTable, frozen=True, kw_only=True):
    """Plant behind a dead zone, with its reference, observer and controller.

    Example:
        >>> scenario = uz.Scenario(
        ...     plant=plant,
        ...     sensor=sensor,
        ...     reference=reference,
        ...     observer=observer,
        ...     simulation=simulation,
        ... )
        >>> scenario.observer.disturbance
        0.2

    See Also:
        read, simulate, check, export

    Attributes:
        plant: the plant.
        sensor: the sensor at its output, with a dead zone.
        reference: the signal that its tracked outputs should follow.
        observer: the method that estimates state and widths (default `auto` with the assumptions of
            [declared], or with widths between 0 and three times the largest, likewise `contact` for
            an arm with gears).
        controller: the method that computes the input (default `state_feedback`, for rigid arms
            `computed_torque`, for an elastic joint in sampled time `lqr`).
        simulation: length of a run, and how it is computed.
        model: the plant as observer and controller know it (default: the plant itself).
        disturbance: a signal added to the input (default: none).
        tracked: the outputs that follow the reference, counted from 0 (default: the first
            min(inputs, outputs)).
        behind_play: speed of crossing the gap of a play when the reference reverses, which makes
            the load (y / m) follow the reference in place of z [1/s] (default: z follows).
        units: names of units for labels and columns (default: 1, of an arm rad, N m and rad/s).
        ensemble: distributions of the numbers that vary among many runs.
        tune: the numbers that `undeadzone tune` may change, and to what end.
        declared: assumptions that the methods of `undeadzone arena` get.
        compare: another observer, whose run `undeadzone run` shows beside the first. With
            `like = "observer"` it has the keys of [observer], but for those that it names.
        region: states and inputs on which `undeadzone check` certifies a nonlinear model.
        title: title of figures and pages.
        schema: number of the meanings that keys have, 3 (docs/versions.md).
        actuator: actuator between the controller and the plant (default: nothing).
        compensator: map from the controller's input to the actuator's command (default
            `smooth_inverse` if there is an actuator).
        operating_point: input and output at rest, from which all other numbers count, widths too.
            Signals of logs, results and exported code stay in the units of the plant (default: 0).
    """

    plant: Plant
    sensor: Sensor
    reference: Signal
    observer: ObserverOptions = UNNAMED
    controller: ControllerOptions = UNNAMED
    simulation: Simulation = Simulation()
    model: Model | None = None
    disturbance: Disturbance | None = None
    tracked: list[int] | None = None
    behind_play: float | None = None
    units: Units = Units()
    ensemble: Vary | None = None
    tune: Tune | None = None
    declared: Assumptions | None = None
    compare: ObserverOptions | None = None
    region: Region | None = None
    title: str = "Untitled"
    schema: int | None = None
    actuator: Actuator | None = None
    compensator: CompensatorOptions | None = None
    operating_point: OperatingPoint | None = None

    def __post_init__(self) -> None:
        """Put the usual observer and controller where none is named. Raises InputError."""
        for field in msgspec.structs.fields(Scenario):
            value = getattr(self, field.name)
            if value is not None or field.default is not None:
                require_kind(field.name, value, field.type)
        for side in ("right", "left"):
            require_array(f"sensor.{side}", getattr(self.sensor, side), infinite=True)
        if self.schema not in (None, SCHEMA):
            raise InputError(
                f"schema: expected {SCHEMA}, found {self.schema!r:.40}. Up to schema 2 a centre of "
                f"the zone was d_r - d_l: halve it, and write schema = {SCHEMA}"
            )
        if self.observer is UNNAMED:
            observer = usual_observer(self.plant, self.sensor, self.declared)
            msgspec.structs.force_setattr(self, "observer", observer)
        if self.controller is UNNAMED:
            controller = usual_controller(self.plant, self.simulation.time == "sampled")
            msgspec.structs.force_setattr(self, "controller", controller)

    def replace(self, address: str, value: Any) -> Scenario:
        """Return the scenario with another value at one key: `scenario.replace("sensor.right",
        1.2)`.

        Args:
            address: dotted key, with an index for one entry: `sensor.right`, `plant.A[1,0]`.
            value: number, list, text, table of keys, or a struct such as `Kalman()`.

        Returns:
            A new scenario. This one stays as it is.

        Raises:
            InputError: no such key, or a value that it cannot take.
        """
        return with_value(self, address, value)

    def __or__(self, changes: Mapping[str, Any]) -> Scenario:
        """Return the scenario with other tables: `scenario | {"sensor": {"right": 1.2}}`.

        A table keeps the keys that are not changed, unless its `kind` or `method` is another one.

        Raises:
            InputError: no such key, or a value that it cannot take.
        """
        return with_tables(self, changes)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the scenario as TOML, every number exactly.

        Args:
            path: of the file, which `read` and the command line take.

        Returns:
            The path.

        Raises:
            FileError: it cannot be written.
            InputError: something in it that no text can hold, such as a Python function.
        """
        return write_text(toml.to_toml(self), path)

    def __str__(self) -> str:
        """Return the scenario as TOML."""
        try:
            return toml.to_toml(self)
        except InputError:
            return repr(self)

    def _repr_html_(self) -> str:
        """Return the same, for a notebook."""
        return shown.source_to_html(str(self))
