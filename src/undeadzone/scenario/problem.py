"""Parts of a scenario, built and checked: errors are reported here, by key, before a run.

That includes the path of an arm's joints that a reference needs, and an arm's units: SI.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import msgspec
import numpy as np

from undeadzone.compensators import PlayInverse, SmoothZoneInverse
from undeadzone.controllers.parts.behind_play import lead_across_gap
from undeadzone.controllers.parts.estimated import use_gear_estimates
from undeadzone.controllers.parts.predicted import predict_over_delay
from undeadzone.errors import InputError
from undeadzone.feedforward.joint_path import after_swing, joint_path, require_range, require_torque
from undeadzone.feedforward.targets import flat_targets
from undeadzone.interfaces import Compensator, Controller, Observer
from undeadzone.linalg.structure import require_structure
from undeadzone.nonlinearities.actuator import (
    ActuatorModel,
    Belief,
    Drive,
    believe_actuator,
    resolve_actuator,
)
from undeadzone.nonlinearities.play import gaps_of
from undeadzone.nonlinearities.sensor import Sensor, Zone
from undeadzone.observers import Auto
from undeadzone.observers.filtering.actuator import build_with_actuator
from undeadzone.observers.filtering.motion_detection import require_branch_observer
from undeadzone.plants import build as plants
from undeadzone.plants.options import Plant, linear_matrices
from undeadzone.plants.region import build_box
from undeadzone.plants.system import System, plant_pace
from undeadzone.registry import ObserverOptions
from undeadzone.scenario.encoders import group_coupled_joints, require_gears, resolve_sensor
from undeadzone.scenario.messages import require_words
from undeadzone.scenario.operating_point import Levels, resolve_levels
from undeadzone.scenario.overrun import require_contact
from undeadzone.scenario.schema import Model, Scenario, Simulation, Units
from undeadzone.scenario.time_step import (
    require_bounded_error,
    require_fine_step,
    require_resolved,
    require_steps,
    sample_within_limits,
)
from undeadzone.signals import exosystem as signals
from undeadzone.signals.exosystem import Exosystem
from undeadzone.util.arrays import Array, Floats, require_nonnegative, require_number

NO_CONTROLLER = Controller(
    (), lambda params: (), lambda params, state, *given: (state, ca.SX(0, 1))
)
PATH_STEP = 0.01  # [s] between the instants at which a path is checked


class Problem(NamedTuple):
    """The checked parts of a scenario.

    Attributes:
        scenario: scenario from which they were built.
        plant: sampled when the simulation is.
        model: the plant as observer and controller know it (sampled when the simulation is).
        flow: the model in continuous time.
        sensor: the dead zone.
        observer, controller: built for the model.
        reference: of the tracked outputs.
        disturbance: at the input (None: none, or a random one).
        tracked: numbers of the outputs that follow the reference.
        x0: the plant's initial state (n).
        steps: how many a run has.
        path: of the coordinates of a model that is flat, a robot's joints (None: it is not flat).
        actuator: ahead of the plant (None: there is none).
        belief: state of knowledge about it (None: there is none).
        compensator: of its dead zone (None: there is none).
        levels: of the signals at the operating point (None: all are 0).
    """

    scenario: Scenario
    plant: System
    model: System
    flow: System
    sensor: Zone
    observer: Observer
    controller: Controller
    reference: Exosystem
    disturbance: Exosystem | None
    tracked: list[int]
    x0: Floats
    steps: int
    path: Exosystem | None = None
    actuator: Drive | None = None
    belief: Belief | None = None
    compensator: Compensator | None = None
    levels: Levels | None = None


def resolve_scenario(scenario: Scenario) -> Problem:
    """Build and check every part of a scenario.

    Raises:
        InputError: or a subclass, naming the key, the value found and the remedy.
    """
    true, flow, x0 = systems(scenario)
    step, steps = require_steps(scenario, true)
    rate = plant_pace(flow.linear)
    sensor = resolve_sensor(scenario.sensor, true, step, rate)
    _require_numbers(sensor)
    tracked = _tracked_outputs(scenario, true)
    reference, path = _reference(scenario, flow, tracked, x0, step)
    disturbance = _disturbance(scenario, true.m)
    if disturbance is not None:
        require_resolved("disturbance", disturbance, step)
    plant = true
    model = flow
    if scenario.simulation.time == "sampled":
        substeps = scenario.simulation.substeps
        if not 1 <= substeps <= 1000:
            raise InputError(f"simulation.substeps: expected 1 to 1000, found {substeps}")
        plant = sample_within_limits("plant", true, step, substeps)
        model = sample_within_limits("model", flow, step, substeps)
    else:
        _require_no_samples(true, flow, sensor)
    require_contact(sensor, reference, tracked, steps * step, step)
    actuator, belief = _actuator(scenario, true.m)
    if scenario.model is not None and scenario.model.play is not None:
        _require_play(scenario.model.play, sensor)
    assumed = resolve_sensor(sensor_of_model(scenario), flow, step, rate)
    require_branch_observer(scenario.observer, sensor)
    options = scenario.observer
    if path is not None:
        along = path.output_at(np.arange(steps + 1) * step)
        options = group_coupled_joints(options, model, along)
    observer = watching(options, model, assumed, belief, step)
    _require_room(sensor, observer)
    require_gears("controller", scenario.controller, model)
    controller = scenario.controller.build(model) if model.m else NO_CONTROLLER
    controller = use_gear_estimates(controller, model, observer.traits.uncertain)
    controller = lead_across_gap(controller, model, sensor, tracked, scenario.behind_play)
    controller = predict_over_delay(controller, model, belief)
    if model.Ts is None:
        require_fine_step(plant, model, observer, controller, step)
    if scenario.region is not None:
        build_box(scenario.region, model)
    return Problem(
        scenario=with_units(scenario, true),
        plant=plant,
        model=model,
        flow=flow,
        sensor=sensor,
        observer=observer,
        controller=controller,
        reference=reference,
        disturbance=disturbance,
        tracked=tracked,
        x0=x0,
        steps=steps,
        path=path,
        actuator=actuator,
        belief=belief,
        compensator=_compensator(scenario, model, belief),
        levels=resolve_levels(scenario.operating_point, true, sensor.slope, tracked),
    )


def _require_no_samples(plant: System, model: System, sensor: Zone) -> None:
    """Raise InputError in continuous time if a part needs samples."""
    play = "sensor.kind" if sensor.play is None else "sensor.play"
    needed = {
        "plant.delay: counts samples": plant.delay or model.delay,
        "sensor.quantum: a reading is rounded when it is taken": sensor.quantum.any(),
        "plant.arm.gears: contacts close and open too fast for steps that locate each": plant.gears,
        "sensor.left: inf, no edge, is known to the filters alone": sensor.absent.any(),
        f"{play}: a play shows its side from one reading to the next": sensor.moves,
    }
    for reason, is_needed in needed.items():
        if is_needed:
            raise InputError(f'{reason}. Set simulation.time = "sampled"')


def watching(
    options: ObserverOptions, model: System, assumed: Zone, belief: Belief | None, step: float
) -> Observer:
    """Return the observer of a model behind a sensor, built and checked.

    Args:
        options: of the observer.
        model: the model, of one step if sampled.
        assumed: the sensor as the observer knows it.
        belief: state of knowledge about the actuator (None: there is none).
        step: of the simulation, or between samples [s].

    Raises:
        InputError: or a subclass, that names the key.
    """
    require_branch_observer(options, assumed)
    if not model.m and not isinstance(options, Auto):
        raise InputError("observer.method: a signal has no input, which only 'auto' can filter")
    require_gears("observer", options, model)
    observer = build_with_actuator(options, model, assumed, belief)
    require_bounded_error(model, observer, step)
    return observer


def describe_actuator(scenario: Scenario) -> ActuatorModel | None:
    """Return the model of the actuator as options, or None without an actuator."""
    given = None if scenario.model is None else scenario.model.actuator
    if scenario.actuator is None:
        return given
    keys = ActuatorModel.__struct_fields__
    return ActuatorModel(**_given_keys(scenario.actuator, keys) | _given_keys(given, keys))


def sensor_of_model(scenario: Scenario) -> Sensor:
    """Return the sensor as observers know it, as options: with the values of [model]."""
    given = _given_keys(scenario.model, ("load_friction", "play"))
    return msgspec.structs.replace(scenario.sensor, **given)


def _given_keys(table: msgspec.Struct | None, keys: Iterable[str]) -> dict[str, Any]:
    """Return the values that a table has under some keys, empty if the table is absent."""
    values = {key: getattr(table, key, None) for key in keys}
    return {key: value for key, value in values.items() if value is not None}


def _require_numbers(sensor: Zone) -> None:
    """Raise InputError if the sensor itself has a range in place of a number."""
    if sensor.friction_std.any():
        raise InputError(
            "sensor.load_friction: expected a number, a simulation needs one. Give the range as "
            "model.load_friction"
        )
    if sensor.play is not None and sensor.play.ranges is not None:
        raise InputError(
            "sensor.play: expected numbers, a simulation needs them. Give the ranges as model.play"
        )


def _require_play(given: Array, sensor: Zone) -> None:
    """Raise InputError unless [model] gives possible gaps of an existing play."""
    gaps_of(given, sensor.right.size, "model.play")
    if sensor.play is None and np.any(given):
        raise InputError(
            "model.play: the sensor has no play ahead of its dead zone. Give sensor.play, or leave "
            "it out"
        )


def _actuator(scenario: Scenario, inputs: int) -> tuple[Drive | None, Belief | None]:
    """Return the actuator and the knowledge about it, each None if absent. Raises InputError."""
    belief = believe_actuator(describe_actuator(scenario), inputs)
    if scenario.actuator is None:
        return None, belief
    drive = resolve_actuator(scenario.actuator, inputs)
    if drive.has_rate_limit and scenario.simulation.time != "sampled":
        raise InputError('actuator.rate: needs samples. Set simulation.time = "sampled"')
    if drive.is_play and scenario.simulation.time != "sampled":
        raise InputError('actuator.kind: "play" needs samples. Set simulation.time = "sampled"')
    return drive, belief


def _compensator(scenario: Scenario, model: System, belief: Belief | None) -> Compensator | None:
    """Return the compensator of a scenario, by default an inverse of a known actuator."""
    if scenario.compensator is not None:
        return scenario.compensator.build(model, belief)
    if belief is None:
        return None
    usual: Any = PlayInverse() if belief.drive.is_play else SmoothZoneInverse()
    return usual.build(model, belief)


def _require_room(sensor: Zone, observer: Observer) -> None:
    """Raise InputError if the widths lie beyond d_M: projection keeps estimates from them."""
    limit = observer.traits.width_max
    if limit is None:
        return
    beyond = np.maximum(sensor.right, sensor.left) > limit
    if beyond.any():
        output = int(beyond.argmax())
        raise InputError(
            f"observer.width_max: the sensor's widths of output {output}, right "
            f"{sensor.right[output]:g} and left {sensor.left[output]:g}, lie beyond d_M = "
            f"{limit[output]:g}: the projection would keep the estimates from the truth. "
            "Raise width_max"
        )


def systems(scenario: Scenario) -> tuple[System, System, Floats]:
    """Return (the plant, the model, x(0)) in continuous time, checked against each other.

    Raises:
        InputError: or a subclass, naming the key.
    """
    if not isinstance(scenario, Scenario):
        raise InputError(
            f"scenario: expected uz.Scenario(...), found {type(scenario).__name__}. A file is read "
            'by uz.read("mine.toml")'
        )
    for key, options in (("sensor", Sensor), ("simulation", Simulation)):
        require_words(key, getattr(scenario, key), options)
    plant = plants.system(scenario.plant)
    require_visible(plant, "plant")
    model = plant
    if scenario.model is not None:
        model = plants.system(plant_of_model(scenario), "model")
        require_visible(model, "model")
        if (model.n, model.m, model.p) != (plant.n, plant.m, plant.p):
            raise InputError(
                f"model: expected {plant.n} states, {plant.m} inputs, {plant.p} outputs like the "
                f"plant, found {model.n}, {model.m}, {model.p}"
            )
    return plant, model, plants.initial_state(scenario.plant, plant)


def require_visible(system: System, key: str) -> None:
    """`require_structure`, but for an arm, whose structure changes with its posture.

    For an arm, see the verdict of a run.
    """
    if system.flat is None:
        require_structure(system.linear, key)


def plant_of_model(scenario: Scenario) -> Plant:
    """Return the plant as observer and controller know it: [model] over [plant].

    Raises InputError.
    """
    model = scenario.model
    plant = scenario.plant
    if model is None:
        return plant
    if model.delay is not None:
        plant = msgspec.structs.replace(plant, delay=model.delay)
    if plant.f is not None or plant.arm is not None:
        return _with_parameters(model, plant, _given_keys(model, "ABC"))
    if model.parameters:
        raise InputError(
            "model.parameters: only a plant given by formulas or an arm has parameters. Use A, B, C"
        )
    linear = linear_matrices(plant)
    return Plant(**{**linear._asdict(), **_given_keys(model, "ABC")}, delay=plant.delay)


def _with_parameters(model: Model, plant: Plant, matrices: dict[str, object]) -> Plant:
    """Return a plant given by formulas or an arm, with the parameters of [model].

    Raises InputError.
    """
    if matrices:
        raise InputError(
            f"model.{min(matrices)}: the plant is given by formulas or an arm. Its model can "
            "change parameters only"
        )
    unknown = sorted(set(model.parameters) - set(plant.parameters))
    if plant.f is not None and unknown:
        raise InputError(
            f"model.parameters.{unknown[0]}: unknown parameter. The plant has "
            f"{', '.join(plant.parameters) or 'none'}"
        )
    return msgspec.structs.replace(plant, parameters=plant.parameters | model.parameters)


def _tracked_outputs(scenario: Scenario, plant: System) -> list[int]:
    """Return the numbers of the outputs that follow the reference. Raises InputError."""
    if scenario.tracked is None:
        return list(range(min(plant.m, plant.p)))
    tracked: Any = scenario.tracked  # a program may give anything
    there = [*range(plant.p)]
    if not isinstance(tracked, Sequence) or not all(index in there for index in tracked):
        tracked = []
    if not 0 < len({*tracked}) == len(tracked):
        raise InputError(
            f"tracked: expected different output numbers from 0 to {plant.p - 1}, found "
            f"{scenario.tracked!r:.40}"
        )
    return [*map(int, tracked)]


def _reference(
    scenario: Scenario, flow: System, tracked: list[int], x0: Floats, step: float
) -> tuple[Exosystem, Exosystem | None]:
    """Return the reference of the tracked outputs, and the path of a flat model's coordinates."""
    if flow.flat is None:
        reference = signals.build_exosystem("reference", scenario.reference, len(tracked))
        require_resolved("reference", reference, step)
        return reference, None
    path = flat_path(scenario, flow, x0, step)
    size = len(tracked)
    reference = Exosystem(
        np.zeros((size, size)), np.eye(size), lambda t: flat_targets(flow, path, tracked, t).r
    )
    require_resolved("reference", path, step)
    return reference, path


def _disturbance(scenario: Scenario, inputs: int) -> Exosystem | None:
    """Return the disturbance at the inputs, or None if it is absent or random."""
    signal = scenario.disturbance
    if signal is None:
        return None
    if isinstance(signal, signals.Random):
        require_nonnegative(
            "disturbance.rms", signal.rms, inputs, f"one per input, there are {inputs}"
        )
        require_number("disturbance.correlation_time", signal.correlation_time, above=0.0)
        return None
    return signals.build_exosystem("disturbance", signal, inputs)


def constant_gains(observer: Observer, model: System) -> tuple[Floats, Floats] | None:
    """Return (L, gamma), both [1/s], of an observer with constant gains, else None."""
    traits = observer.traits
    if not traits.constant or traits.L is None or traits.gamma is None:
        return None
    return traits.L / model.per_step, traits.gamma / model.per_step


def flat_path(scenario: Scenario, model: System, start: Floats, step: float) -> Exosystem:
    """Return the path of the flat coordinates: of the joints, or of an elastic joint's link.

    The reference gives it as such, or for the tip.

    Args:
        scenario: the scenario, for its reference and duration.
        model: model of the robot, in continuous time.
        start: the state from which the joints set out (n).
        step: between the instants at which a path of the tip is checked [s].

    Raises:
        InputError: or a subclass: TrackingError if the tip or the motors cannot follow.
    """
    reference = scenario.reference
    duration = scenario.simulation.duration
    body = model.arm
    assert body is not None
    t = np.append(np.arange(0.0, duration, max(step, PATH_STEP)), duration)
    if getattr(reference, "space", "joint") == "joint":
        path = signals.build_exosystem("reference", reference, model.m)
        if model.m == body.joint_count:
            require_range(body.chain, t, path.output_at(t), path.output_at(t, 1))
    elif model.m < body.joint_count:
        raise InputError(
            "reference.space: the path of an elastic joint is its link's angle. Use space = 'joint'"
        )
    else:
        task = signals.build_exosystem("reference", reference, len(body.chain.plane), task=True)
        params, posture = model.joints(model.params, start)
        swing = getattr(reference, "swing", None)
        begin = (
            0.0
            if swing is None
            else require_number("reference.swing.until", swing.until, above=0.0)
        )
        path = joint_path(body, params, task, max(duration - begin, step), step, posture)
        if swing is not None:
            path = after_swing(path, swing)
            require_range(body.chain, t, path.output_at(t), path.output_at(t, 1))
    require_torque(model, path, t)
    return path


def with_units(scenario: Scenario, plant: System) -> Scenario:
    """Return the scenario with the units of an arm if it has no units.

    The outputs, inputs and states of other plants may be anything: they keep the unit 1. So do
    those of an arm with sliding joints, which has outputs of two units.

    Args:
        scenario: that was read.
        plant: its plant.
    """
    arm = plant.arm
    if arm is None or arm.chain.slides or scenario.units != Units():
        return scenario
    velocity = getattr(scenario.plant.arm, "measured", None) == "velocity"
    half = plant.n // 2
    units = Units(
        output="rad/s" if velocity else "rad",
        input="N m",
        state=half * ["rad"] + half * ["rad/s"],
    )
    return msgspec.structs.replace(scenario, units=units)
