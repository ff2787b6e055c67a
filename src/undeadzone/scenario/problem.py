"""From a scenario's words to checked parts: what is wrong with an input is said here, by key, before anything runs."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from undeadzone.controllers import Controller
from undeadzone.errors import InputError, ShapeError, StepError, StructureError
from undeadzone.feedforward.targets import flat_targets
from undeadzone.linear.structure import require_structure
from undeadzone.observers import NumericObserver, Observer
from undeadzone.plants import build as plants
from undeadzone.plants.options import Plant
from undeadzone.plants.region import box
from undeadzone.plants.system import System, sampled
from undeadzone.scenario import reference_path as paths
from undeadzone.scenario.schema import Scenario
from undeadzone.sensor import Zone, resolve
from undeadzone.signals import exosystem as signals
from undeadzone.signals.exosystem import Exosystem
from undeadzone.support.arrays import Floats, nonnegative, scalar

STABLE = 2.5  # largest |pole| times a Runge-Kutta step: beyond about 2.78 it is unstable
MEMORY = 4e9  # [bytes] of signals that one run may hold


class Problem(NamedTuple):
    """The checked parts of a scenario. plant and model are sampled when the simulation is; flow is the continuous model.

    reference: of the tracked outputs; path: of the coordinates of a model that is flat, a robot's joints.
    """

    scenario: Scenario
    plant: System
    model: System
    flow: System
    sensor: Zone
    observer: Observer | NumericObserver
    controller: Controller
    reference: Exosystem
    disturbance: Exosystem | None
    tracked: list[int]
    x0: Floats
    steps: int
    path: Exosystem | None = None


def resolve_scenario(scenario: Scenario) -> Problem:
    """Build and check every part. Raises InputError and its kinds, naming the key, what was found and what to do."""
    true, flow, x0 = systems(scenario)
    step, steps = _time(scenario, true)
    sensor = resolve(scenario.sensor, true.p, step)
    tracked = _tracked(scenario, true)
    if flow.flat is None:
        path, reference = None, signals.exosystem("reference", scenario.reference, len(tracked))
    else:
        path = paths.followed(scenario, flow, x0, step)
        reference = Exosystem(
            np.zeros((len(tracked),) * 2),
            np.eye(len(tracked)),
            lambda t: flat_targets(flow, path, tracked, t).r,
        )
    _require_resolved("reference", reference if path is None else path, step)
    disturbance = _disturbance(scenario, true.m)
    if disturbance is not None:
        _require_resolved("disturbance", disturbance, step)
    plant, model = true, flow
    if scenario.simulation.time == "continuous" and sensor.quantum.any():
        raise InputError(
            'sensor.quantum: a reading is rounded when it is taken; set simulation.time = "sampled"'
        )
    if scenario.simulation.time == "sampled":
        substeps = scenario.simulation.substeps
        if not 1 <= substeps <= 1000:
            raise InputError(f"simulation.substeps: expected 1 to 1000, found {substeps}")
        plant, model = (
            _sampled(key, system, step, substeps)
            for key, system in (("plant", true), ("model", flow))
        )
    observer = scenario.observer.build(model, sensor)
    _require_room(sensor, observer)
    controller = scenario.controller.build(model)
    require_bounded_error(model, observer, step)
    if model.Ts is None:
        _require_fine_step(plant, model, observer, controller, step)
    if scenario.region is not None:
        box(scenario.region, model)
    return Problem(
        scenario,
        plant,
        model,
        flow,
        sensor,
        observer,
        controller,
        reference,
        disturbance,
        tracked,
        x0,
        steps,
        path,
    )


def _require_room(sensor: Zone, observer: Observer | NumericObserver) -> None:
    """Raise InputError where the widths lie beyond d_M, so that projection keeps the estimates from the truth."""
    limit = observer.traits.width_max
    if limit is None:
        return
    beyond = np.maximum(sensor.right, sensor.left) > limit
    if beyond.any():
        output = int(beyond.argmax())
        raise InputError(
            f"observer.width_max: the sensor's widths of output {output}, right {sensor.right[output]:g} and left {sensor.left[output]:g}, "
            f"lie beyond d_M = {limit[output]:g}: the projection would keep the estimates from the truth; raise width_max"
        )


def systems(scenario: Scenario) -> tuple[System, System, Floats]:
    """(the plant, the model, x(0)) in continuous time, checked against each other. Raises InputError and its kinds."""
    plant = plants.system(scenario.plant)
    require_visible(plant, "plant")
    model = plant
    if scenario.model is not None:
        model = plants.system(believed_plant(scenario), "model")
        require_visible(model, "model")
        if (model.n, model.m, model.p) != (plant.n, plant.m, plant.p):
            raise InputError(
                f"model: expected {plant.n} states, {plant.m} inputs, {plant.p} outputs like the plant, found {model.n}, {model.m}, {model.p}"
            )
    return plant, model, plants.initial_state(scenario.plant, plant.n)


def require_visible(system: System, key: str) -> None:
    """`require_structure`; of an arm, whose structure changes with its posture, a run's own verdict tells."""
    if system.flat is None:
        require_structure(system.linear, key)


def believed_plant(scenario: Scenario) -> Plant:
    """The plant as observer and controller see it: [model] over [plant]. Raises InputError."""
    model, plant = scenario.model, scenario.plant
    if model is None:
        return plant
    matrices = {name: getattr(model, name) for name in "ABC" if getattr(model, name) is not None}
    if plant.f is not None or plant.arm is not None:
        if matrices:
            raise InputError(
                f"model.{min(matrices)}: the plant is given by formulas or an arm; its model can change parameters only"
            )
        if plant.f is not None and (
            unknown := sorted(set(model.parameters) - set(plant.parameters))
        ):
            raise InputError(
                f"model.parameters.{unknown[0]}: unknown parameter; the plant has {', '.join(plant.parameters) or 'none'}"
            )
        return msgspec.structs.replace(plant, parameters=plant.parameters | model.parameters)
    if model.parameters:
        raise InputError(
            "model.parameters: only a plant given by formulas or an arm has parameters; use A, B, C"
        )
    linear = plants.matrices(plant)
    return Plant(**{**linear._asdict(), **matrices})


def _time(scenario: Scenario, plant: System) -> tuple[float, int]:
    duration = scalar("simulation.duration", scenario.simulation.duration, above=0.0)
    step = scalar("simulation.step", scenario.simulation.step, above=0.0)
    if step > duration:
        raise StepError(f"simulation.step: {step:g} s is longer than the duration, {duration:g} s")
    if not 4 <= scenario.simulation.order <= 20:
        raise InputError(f"simulation.order: expected 4 to 20, found {scenario.simulation.order}")
    if scenario.simulation.order > 4 and (
        scenario.simulation.time == "sampled"
        or scenario.simulation.switching == "plain"
        or plant.nonlinear
    ):
        raise InputError(
            "simulation.order: above 4 only in continuous time, for a linear plant, with located switching; use 4"
        )
    if not 0 <= (seed := scenario.simulation.seed) < 2**63:
        raise InputError(
            f"simulation.seed: must {'not be negative' if seed < 0 else 'be below 2^63'}, found {seed}"
        )
    numbers = 15 * (
        plant.n + 2 * plant.m + 4 * plant.p
    )  # a step, the check at half the step included
    if duration / step * numbers * 8 > MEMORY:
        raise StepError(
            f"simulation.step: {duration / step:.3g} steps would need more than {MEMORY / 1e9:g} GB; use a longer step or a shorter duration"
        )
    names = scenario.units.state
    if not isinstance(names, str) and len(names) != plant.n:
        raise ShapeError(
            f"units.state: expected one unit, or {plant.n} (one per state), found {len(names)}"
        )
    return step, round(duration / step)


def _tracked(scenario: Scenario, plant: System) -> list[int]:
    tracked = list(range(min(plant.m, plant.p))) if scenario.tracked is None else scenario.tracked
    if (
        not tracked
        or len(set(tracked)) < len(tracked)
        or not all(0 <= index < plant.p for index in tracked)
    ):
        raise InputError(
            f"tracked: expected different output numbers from 0 to {plant.p - 1}, found {tracked}"
        )
    return tracked


def _disturbance(scenario: Scenario, inputs: int) -> Exosystem | None:
    signal = scenario.disturbance
    if isinstance(signal, signals.Random):
        nonnegative("disturbance.rms", signal.rms, inputs, f"one per input, there are {inputs}")
        scalar("disturbance.correlation_time", signal.correlation_time, above=0.0)
        return None
    return None if signal is None else signals.exosystem("disturbance", signal, inputs)


def _require_resolved(key: str, signal: Exosystem, step: float) -> None:
    tone = float(np.abs(np.linalg.eigvals(signal.S).imag).max()) / 2 / np.pi
    if tone * step >= 0.5:
        raise StepError(
            f"simulation.step: {step:g} s is too coarse for {key}: {tone:.4g} Hz is not below half of 1 / step, {0.5 / step:.4g} Hz"
        )


def _sampled(key: str, system: System, step: float, substeps: int) -> System:
    """The sampled system; it is observable where the continuous one is, since no two poles fall on one (Kalman, Ho, Narendra 1963)."""
    poles = np.linalg.eigvals(system.linear.A)
    fastest, growth = float(np.abs(poles.imag).max()), float(poles.real.max())
    if fastest * step >= np.pi:
        raise StepError(
            f"simulation.step: {step:g} s is too coarse: the {key} oscillates at {fastest / 2 / np.pi:.4g} Hz, sample faster than twice that"
        )
    if growth * step > 10:
        raise StepError(
            f"simulation.step: {step:g} s is too coarse: the {key} grows at {growth:.4g} 1/s, e^{growth * step:.3g}-fold within one sample"
        )
    if system.nonlinear and (fastest := float(np.abs(poles).max())) * step / substeps > STABLE:
        raise StepError(
            f"simulation.step: {step:g} s in {substeps} Runge-Kutta steps is too coarse: the {key} has a mode at {fastest:.4g} 1/s where it is linearised "
            f"(an arm's Coulomb friction is steep near rest); use simulation.substeps = {int(np.ceil(fastest * step / STABLE))} or more"
        )
    found = sampled(system, step, substeps)
    if not all(np.isfinite(part).all() for part in found.linear):
        raise StepError(
            f"simulation.step: {step:g} s is too coarse: the {key} cannot be sampled (its matrices overflow)"
        )
    return found


def constant_gains(
    observer: Observer | NumericObserver, model: System
) -> tuple[Floats, Floats] | None:
    """(L, gamma), both [1/s], of an observer that corrects with constant ones; else None."""
    traits = observer.traits
    if not traits.constant or traits.L is None or traits.gamma is None:
        return None
    step = 1.0 if model.Ts is None else model.Ts
    return traits.L / step, traits.gamma / step


def largest_gamma(observer: Observer | NumericObserver) -> float:
    """The largest gain of a width, per step when the model is sampled; 0 where none is constant."""
    gamma = observer.traits.gamma
    return 0.0 if gamma is None else float(gamma.max())


def require_bounded_error(model: System, observer: Observer | NumericObserver, step: float) -> None:
    """Raise StructureError if the model is unstable and A - L C too, StepError if gamma is too large for the sample time."""
    gamma, L = largest_gamma(observer), observer.traits.L
    if model.Ts is not None and gamma >= 2:
        raise StepError(
            f"simulation.step: {step:g} s is too coarse for observer.gamma: gamma * step = {gamma:.4g} must be below 2"
        )
    if L is None:
        return
    free, active = (
        np.linalg.eigvals(model.linear.A),
        np.linalg.eigvals(model.linear.A - L @ model.linear.C),
    )

    def growth(poles: np.ndarray) -> float:
        return float(
            poles.real.max() if model.Ts is None else np.log(np.abs(poles).max()) / model.Ts
        )

    if growth(free) > 1e-9 and growth(active) >= 0:
        raise StructureError(
            f"observer.L: the model is unstable (growth rate {growth(free):.4g} 1/s) and this gain cannot bound the estimation error: "
            f"A - L C grows at {growth(active):.4g} 1/s; choose L so that A - L C is stable"
        )


def _require_fine_step(
    plant: System,
    model: System,
    observer: Observer | NumericObserver,
    controller: Controller,
    step: float,
) -> None:
    """Raise StepError where RK4 would be unstable or useless on some linear part of the loop."""
    gamma, L, K = largest_gamma(observer), observer.traits.L, controller.K
    parts = {"the plant": plant.linear.A}
    if L is not None:
        A, _, C = model.linear
        parts["the observer, A - L C with gamma,"] = np.block(
            [[A - L @ C, L], [gamma * C, -gamma * np.eye(model.p)]]
        )
    if K is not None:
        parts["the controlled model, A - B K,"] = model.linear.A - model.linear.B @ K
    if observer.traits.rate is not None:
        parts["the observer's adaptation"] = np.array([[-observer.traits.rate]])
    if controller.rate is not None:
        parts["the controller's filter"] = np.array([[-controller.rate]])
    for name, matrix in parts.items():
        fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
        if fastest * step > STABLE:
            raise StepError(
                f"simulation.step: {step:g} s is too coarse: {name} has a mode at {fastest:.4g} rad/s; use at most {1.0 / fastest:.2g} s"
            )
