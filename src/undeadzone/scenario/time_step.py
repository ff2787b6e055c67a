"""Tests of a scenario's time step against its parts: signals, plant, observer and controller."""

from __future__ import annotations

from typing import Final

import numpy as np

from undeadzone.errors import InputError, ShapeError, StepError, StructureError
from undeadzone.interfaces import Controller, Observer
from undeadzone.linalg.matrices import spectral_radius
from undeadzone.linalg.poles import slowest_growth_rate
from undeadzone.plants.system import System, sample_plant
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.signals.exosystem import Exosystem
from undeadzone.util.arrays import require_number, require_seed

STABLE: Final = 2.5  # largest |pole| times a Runge-Kutta step: beyond about 2.78 it is unstable
MEMORY: Final = 4e9  # [bytes] of signals that one run may hold
GROWTH: Final = 10  # largest exponent by which a plant may grow within one sample


def require_steps(scenario: Scenario, plant: System) -> tuple[float, int]:
    """Return the step [s] and the number of steps of a simulation.

    Raises:
        StepError: the step is longer than the run, or so short that memory would not do.
        InputError: order, seed or duration are impossible. ShapeError: the units are.
    """
    simulation = scenario.simulation
    duration = require_number("simulation.duration", simulation.duration, above=0.0)
    step = require_number("simulation.step", simulation.step, above=0.0)
    if step > duration:
        raise StepError(f"simulation.step: {step:g} s is longer than the duration, {duration:g} s")
    _require_order(simulation, plant)
    require_seed("simulation.seed", simulation.seed)
    _require_memory(duration / step, plant)
    names = scenario.units.state
    if not isinstance(names, str) and len(names) != plant.n:
        raise ShapeError(
            f"units.state: expected one unit, or {plant.n} (one per state), found {len(names)}"
        )
    return step, round(duration / step)


def _require_order(simulation: Simulation, plant: System) -> None:
    """Raise InputError for an order of integration that there is not, or not for this plant."""
    order = simulation.order
    if not 4 <= order <= 20:
        raise InputError(f"simulation.order: expected 4 to 20, found {order}")
    smooth = simulation.time == "continuous" and simulation.switching != "plain"
    if order > 4 and (not smooth or plant.nonlinear):
        raise InputError(
            "simulation.order: above 4 only in continuous time, for a linear plant, with located "
            "switching. Use 4"
        )


def _require_memory(steps: float, plant: System) -> None:
    """Raise StepError if the signals of a run would not fit into MEMORY."""
    # Of a step, those of the check at half the step included.
    numbers = 15 * (plant.n + 2 * plant.m + 4 * plant.p)
    if steps * numbers * 8 > MEMORY:
        raise StepError(
            f"simulation.step: {steps:.3g} steps would need more than {MEMORY / 1e9:g} GB. "
            "Use a longer step or a shorter duration"
        )


def require_resolved(key: str, signal: Exosystem, step: float) -> None:
    """Raise StepError if a signal has a tone that the step [s] does not resolve."""
    tone = float(np.abs(np.linalg.eigvals(signal.S).imag).max()) / 2 / np.pi  # [Hz]
    if tone * step >= 0.5:
        raise StepError(
            f"simulation.step: {step:g} s is too coarse for {key}: {tone:.4g} Hz is not below half "
            f"of 1 / step, {0.5 / step:.4g} Hz"
        )


def sample_within_limits(key: str, system: System, step: float, substeps: int) -> System:
    """Return the sampled system.

    It is observable if the continuous one is, since no two poles fall on one (Kalman, Ho, Narendra
    1963).

    Args:
        key: of the system in messages: plant or model.
        system: in continuous time.
        step: sample time [s].
        substeps: Runge-Kutta steps in a sample, of a nonlinear system.

    Raises:
        StepError: the sample time is too long for it.
    """
    poles = np.linalg.eigvals(system.linear.A)
    # [1/s]
    oscillation = float(np.abs(poles.imag).max())
    growth = float(poles.real.max())
    fastest = float(np.abs(poles).max())
    too_coarse = f"simulation.step: {step:g} s is too coarse"
    if oscillation * step >= np.pi:
        raise StepError(
            f"{too_coarse}: the {key} oscillates at {oscillation / 2 / np.pi:.4g} Hz, sample "
            "faster than twice that"
        )
    if growth * step > GROWTH:
        raise StepError(
            f"{too_coarse}: the {key} grows at {growth:.4g} 1/s, e^{growth * step:.3g}-fold "
            "within one sample"
        )
    if system.nonlinear and fastest * step / substeps > STABLE:
        needed = int(np.ceil(fastest * step / STABLE))
        raise StepError(
            f"simulation.step: {step:g} s in {substeps} Runge-Kutta steps is too coarse: the {key} "
            f"has a mode at {fastest:.4g} 1/s in its linearisation (an arm's Coulomb friction is "
            f"steep near rest). Use simulation.substeps = {needed} or more"
        )
    result = sample_plant(system, step, substeps)
    if not all(np.isfinite(part).all() for part in result.linear):
        raise StepError(f"{too_coarse}: the {key} cannot be sampled (its matrices overflow)")
    return result


def _largest_gamma(observer: Observer) -> float:
    """Return the largest gain of a width, per step when the model is sampled, or 0 if no gain is
    constant.
    """
    gamma = observer.traits.gamma
    return 0.0 if gamma is None else float(gamma.max())


def require_bounded_error(model: System, observer: Observer, step: float) -> None:
    """Raise an error if the estimation error of constant gains grows.

    Args:
        model: sampled when the simulation is.
        observer: built for that model.
        step: [s].

    Raises:
        StructureError: the model is unstable, and A - L C too.
        StepError: gamma is too large for the sample time.
    """
    gamma = _largest_gamma(observer)
    L = observer.traits.L
    if model.Ts is not None and gamma >= 2:
        raise StepError(
            f"simulation.step: {step:g} s is too coarse for observer.gamma: gamma * step = "
            f"{gamma:.4g} must be below 2"
        )
    if L is None:
        return
    A, _, C = model.linear
    free = slowest_growth_rate(np.linalg.eigvals(A), model.Ts)
    active = slowest_growth_rate(np.linalg.eigvals(A - L @ C), model.Ts)
    if free > 1e-9 and active >= 0:
        raise StructureError(
            f"observer.L: the model is unstable (growth rate {free:.4g} 1/s) and this gain cannot "
            f"bound the estimation error: A - L C grows at {active:.4g} 1/s. Choose L so that "
            "A - L C is stable"
        )


def require_fine_step(
    plant: System,
    model: System,
    observer: Observer,
    controller: Controller,
    step: float,
) -> None:
    """Raise StepError where RK4 would be unstable or useless on some linear part of the loop."""
    gamma = _largest_gamma(observer)
    L = observer.traits.L
    K = controller.K
    A, B, C = model.linear
    parts = {"the plant": plant.linear.A}
    if L is not None:
        parts["the observer, A - L C with gamma,"] = np.block(
            [[A - L @ C, L], [gamma * C, -gamma * np.eye(model.p)]]
        )
    if K is not None:
        parts["the controlled model, A - B K,"] = A - B @ K
    if observer.traits.rate is not None:
        parts["the observer's adaptation"] = np.array([[-observer.traits.rate]])
    if controller.rate is not None:
        parts["the controller's filter"] = np.array([[-controller.rate]])
    for name, matrix in parts.items():
        fastest = spectral_radius(matrix)
        if fastest * step > STABLE:
            raise StepError(
                f"simulation.step: {step:g} s is too coarse: {name} has a mode at {fastest:.4g} "
                f"rad/s. Use at most {1.0 / fastest:.2g} s"
            )
