"""Closed loops with dead zones at both ends: both unknown against both known.

An exact inverse never lets the actuator fall silent, so one combination of the four widths cannot
be seen; coasts on demand show it (docs/actuator.md).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from benchmarks.loops.plants.random_loops import Loops, ratio_cells, run_loops, white_censored
from benchmarks.markdown import head, row
from undeadzone.compensators import NoInverse, SmoothZoneInverse, ZoneInverse
from undeadzone.controllers import StateFeedback
from undeadzone.nonlinearities.actuator import Actuator, ActuatorModel
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Censored, FullState, Kalman, Luenberger
from undeadzone.plants.options import Plant
from undeadzone.registry import CompensatorOptions, ControllerOptions, ObserverOptions
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Model, Scenario, Simulation
from undeadzone.signals.exosystem import Random, Sine
from undeadzone.util.arrays import Floats
from undeadzone_arena import AdaptiveZoneInverse, RobustAdaptive

NOTHING: Mapping[str, Any] = MappingProxyType({})
STEP, DURATION, NOISE, DISTURBANCE = 0.01, 60.0, 0.01, 0.5
RATE = 6.0  # of the closed loop [1/s]
SLIGHT = 1e-6  # half of the range of a width that is known
OFF = 0.05  # rms by which B of a wrong model is off, relative
OUTPUT = (0.0, 3.0)  # claimed range of the sensor's widths


class World(NamedTuple):
    """One random loop.

    Attributes:
        plant: as it is.
        d, b: true widths of sensor and actuator, [right, left].
        amplitude, frequency: of the reference, [Hz].
        most: largest width of an actuator that is claimed.
        gain: by what factor B of the model is wrong.
    """

    plant: Plant
    d: Floats
    b: Floats
    amplitude: float
    frequency: float
    most: float
    gain: float


def drawn(seed: int) -> World:
    """A random loop of second order; the actuator's widths are a sizeable share of its input."""
    rng = np.random.default_rng([seed, 19])
    a0, a1, b = rng.uniform(0.5, 4.0), rng.uniform(0.8, 4.0), rng.uniform(0.5, 2.0)
    amplitude, w = rng.uniform(2.5, 5.0), rng.uniform(1.0, 4.0)
    size = float(np.clip(max(amplitude * w**2 / b, 3.0), 0.0, 10.0))
    plant = Plant(A=[[0.0, 1.0], [-a0, -a1]], B=[[0.0], [b]], C=[[1.0, 0.0]], x0=[0.5, 0.0])
    widths, gain = rng.uniform(0.3, 2.0, 2), 1 + OFF * rng.standard_normal()
    zone = rng.uniform(0.1, 0.6, 2) * size
    return World(plant, widths, zone, amplitude, w / (2 * np.pi), 7.2, gain)


def narrow(width: float) -> list[float]:
    """The range of a width that is known."""
    return [max(width - SLIGHT, 0.0), width + SLIGHT]


def filter_of(world: World, known: bool) -> Kalman:
    """The filter, with the sensor's widths known or not."""
    right, left = (narrow(width) if known else list(OUTPUT) for width in world.d)
    return Kalman(right=right, left=left, disturbance=DISTURBANCE)


def heedful(world: World) -> Censored:
    """A filter for which the entry of B is one more unknown."""
    options: dict[str, Any] = {"right": list(OUTPUT), "disturbance": DISTURBANCE}
    return white_censored(STEP, tolerance={"B[1,0]": OFF}, **options)


def actuator_of(world: World, known: bool) -> ActuatorModel:
    """What is known of the actuator."""
    if known:
        return ActuatorModel(right=world.b[0], left=world.b[1])
    return ActuatorModel(right=[0.0, world.most], left=[0.0, world.most])


class Method(NamedTuple):
    """An observer, a compensator and what they believe.

    Attributes:
        observer: options of a loop's observer.
        actuator: what is believed of the actuator.
        compensator: its options.
        controller: its options.
        wrong: whether B of the model is wrong.
    """

    observer: Callable[[World], ObserverOptions]
    actuator: Callable[[World], ActuatorModel]
    compensator: CompensatorOptions
    controller: ControllerOptions = StateFeedback(poles=[-RATE, -1.05 * RATE])
    wrong: bool = False


KNOWN = functools.partial(filter_of, known=True)
UNKNOWN = functools.partial(filter_of, known=False)
KNOWN_ACTUATOR = functools.partial(actuator_of, known=True)
UNTOLD = functools.partial(actuator_of, known=False)
COAST: dict[str, Any] = {"every": 2.0, "until": DURATION / 2}


def ignored(world: World) -> ActuatorModel:
    """No dead zone of the actuator is known."""
    return ActuatorModel(right=0.0, left=0.0)


def naive(world: World) -> Luenberger:
    """It takes y for z."""
    return Luenberger(poles=[-12.0, -13.0])


METHODS = {
    "both known": Method(KNOWN, KNOWN_ACTUATOR, ZoneInverse()),
    "both unknown, no coasts": Method(UNKNOWN, UNTOLD, ZoneInverse()),
    "both unknown, smooth inverse, no coasts": Method(UNKNOWN, UNTOLD, SmoothZoneInverse(soft=0.3)),
    "both unknown, coasts of 0.4 s": Method(UNKNOWN, UNTOLD, ZoneInverse(coast=0.4, **COAST)),
    "both unknown, coasts of 0.8 s": Method(UNKNOWN, UNTOLD, ZoneInverse(coast=0.8, **COAST)),
    "B 5 % off, untold, coasts of 0.4 s": Method(
        UNKNOWN, UNTOLD, ZoneInverse(coast=0.4, **COAST), wrong=True
    ),
    "B 5 % off, unknown too, coasts of 0.4 s": Method(
        heedful, UNTOLD, ZoneInverse(coast=0.4, **COAST), wrong=True
    ),
    "`robust_adaptive`, given the true x": Method(
        lambda world: FullState(),
        ignored,
        NoInverse(),
        RobustAdaptive(rate=10.0, poles=[-6.0], layer=0.1, learning=20.0),
    ),
    "sensor's filter, actuator ignored": Method(UNKNOWN, ignored, NoInverse()),
    "adaptive inverse of the actuator, y for z": Method(
        naive, ignored, AdaptiveZoneInverse(width_max=7.2)
    ),
    "neither is known of": Method(naive, ignored, NoInverse()),
}


ALIKE = (
    "both known",
    "both unknown, no coasts",
    "both unknown, coasts of 0.4 s",
    "sensor's filter, actuator ignored",
    "neither is known of",
)
SENSORS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {  # and the methods on each
    "a dead zone": ({}, tuple(METHODS)),
    "a play": ({"kind": "play"}, ALIKE),
    "a dead zone whose reading ends at 2": ({"range": [-2.0, 2.0]}, ALIKE),
}


def posed(method: Method, seed: int, sensor: Mapping[str, Any] = NOTHING) -> Problem:
    """One random loop under a method; sensor: what it is besides its widths."""
    world = drawn(seed)
    gain = world.gain if method.wrong else 1.0
    scenario = Scenario(
        plant=world.plant,
        sensor=Sensor(right=world.d[0], left=world.d[1], noise=NOISE, **sensor),
        actuator=Actuator(right=world.b[0], left=world.b[1]),
        model=Model(B=(gain * np.array(world.plant.B)).tolist(), actuator=method.actuator(world)),
        compensator=method.compensator,
        reference=Sine(amplitude=world.amplitude, frequency=world.frequency),
        observer=method.observer(world),
        controller=method.controller,
        disturbance=Random(rms=DISTURBANCE, correlation_time=1e-4),
        simulation=Simulation(duration=DURATION, time="sampled", step=STEP, seed=seed),
    )
    return resolve_scenario(scenario)


def table(loops: int = 100) -> str:
    """The tables, of that many loops a row."""
    names = ("loops", "rms z - r", "ratio to both known", "90 %", "within 2", "d, b covered")
    lines = ["## Dead zones at both ends\n"]
    for kind, (sensor, methods) in SENSORS.items():
        lines += [f"The sensor is {kind}:\n", *head(*names)]
        best = None
        for name in methods:
            each = [posed(METHODS[name], seed, sensor) for seed in range(loops)]
            ran = run_loops(each, 0.8 * DURATION)
            best = ran.rms if best is None else best
            lines.append(_row(name, ran, best))
        lines.append("")
    about = (
        f"{loops} random loops of second order, {DURATION:g} s, judged in the last fifth; noise "
        f"{NOISE:g}, white disturbance of {DISTURBANCE:g} rms, {1 / STEP:g} Hz. The actuator's "
        "widths are 0.1 to 0.6 of its largest input. Ratio: of the rms of z - r, median with a "
        "95 % interval, and 90 % quantile. Coasts: on demand, in the first half.\n"
    )
    return "\n".join([*lines, about])


def _row(name: str, ran: Loops, best: Floats) -> str:
    """The row of one method."""
    cells = ratio_cells(ran.rms, best, 1)
    cells.append(f"{100 * np.mean(ran.rms <= 2 * best):.0f} %")
    estimates = "unknown" in name or "untold" in name
    covered = [ran.covered(), ran.actuator_covered()] if estimates else []
    return row(name, *cells, ", ".join(part for part in covered if part))
