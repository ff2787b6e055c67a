"""The numbers of a scenario that may vary, by address, and which packed numbers of its loop each of them sets."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.observers import Oracle
from undeadzone.plants.robots.arm import signless
from undeadzone.plants.system import System
from undeadzone.scenario.ensemble_table import POSITIVE
from undeadzone.scenario.problem import Problem
from undeadzone.signals.exosystem import Random, Signal, Sine, Step, Trapezoid
from undeadzone.simulation.loop import Loop
from undeadzone.support import tree
from undeadzone.support.arrays import Floats

PER_SECOND: Final = ("observer.L", "observer.gamma")  # held per step by the loop of a sampled model
LEAST: Final = {
    **dict.fromkeys(
        (
            "sensor.right",
            "sensor.left",
            "sensor.threshold",
            "sensor.noise",
            "sensor.noise_before",
            "disturbance.rms",
            "observer.gamma",
        ),
        0.0,
    ),
    "sensor.slope": POSITIVE,
}
SCALES: Final = {
    "scale.reference": "reference.scale",
    "scale.disturbance": "disturbance.scale",
    "scale.before": "sensor.noise_before",
    "scale.after": "sensor.noise",
}


class Quantity(NamedTuple):
    """A number in the scenario's unit, not below `least`; it sets the packed numbers `slots` of [params, state] to gain times its value."""

    nominal: float
    slots: tuple[int, ...]
    gain: float = 1.0
    least: float = -np.inf


def stem(name: str) -> str:
    """An address without its index."""
    return name.partition("[")[0]


def quantities(problem: Problem, loop: Loop) -> dict[str, Quantity]:
    """Every quantity of a problem, by address, in the order of the loop's packed numbers."""
    found: dict[str, Quantity] = {}
    slots = dict(zip(tree.names(loop.params), range(tree.size(loop.params)), strict=True))
    for (name, slot), value in zip(slots.items(), tree.pack(flowing(problem, loop)), strict=True):
        key, index = stem(name), name[len(stem(name)) :]
        if key in ("h", "controller.tau", "controller.rate") or key in _absent(problem):
            continue
        gain, floor = problem.model.Ts or 1.0 if key in PER_SECOND else 1.0, -np.inf
        if key in ("plant", "observer.model", "controller.model"):
            name = f"{key}.parameters.{problem.plant.names[int(index[1:-1])]}"
            floor = (
                0.0
                if problem.plant.arm is not None and signless(problem.plant.names[int(index[1:-1])])
                else floor
            )
        name = SCALES[key] + index if key in SCALES else name
        found[name] = Quantity(
            value / gain, (slot, *_told(problem, name, slots)), gain, LEAST.get(stem(name), floor)
        )
    found |= {
        f"plant.x0[{i}]": Quantity(x, (tree.size(loop.params) + i,))
        for i, x in enumerate(problem.x0)
    }
    return found | dict(_amplitudes(problem, found))


def flowing(problem: Problem, loop: Loop) -> Any:
    """The loop's params with the matrices of plant and of the observer's model in continuous time."""
    observer = loop.params.observer
    if hasattr(observer, "model"):
        observer = observer._replace(model=_flow(problem.model))
    return loop.params._replace(plant=_flow(problem.plant), observer=observer)


def _flow(system: System) -> Any:
    return system.params if system.nonlinear or system.flow is None else system.flow


def _absent(problem: Problem) -> list[str]:
    """Scales that mean nothing here: the targets of a nonlinear model are not proportional to the reference."""
    return ["scale.reference"] * problem.model.nonlinear + ["scale.disturbance"] * (
        problem.scenario.disturbance is None
    )


def _told(problem: Problem, name: str, slots: dict[str, int]) -> list[int]:
    """Where the observer holds a number of the sensor that it is told: the threshold, and the widths if it is the oracle."""
    key, index = stem(name), name[len(stem(name)) :]
    twin = {"sensor.threshold": "observer.threshold"}
    if isinstance(problem.scenario.observer, Oracle):
        twin |= {"sensor.right": "observer.right0", "sensor.left": "observer.left0"}
    return [slots[twin[key] + index]] if key in twin and twin[key] + index in slots else []


def _amplitudes(problem: Problem, found: dict[str, Quantity]) -> Iterator[tuple[str, Quantity]]:
    """The amplitudes of reference and disturbance that have one size, which is not 0."""
    reference = sizes(problem.scenario.reference, len(problem.tracked))
    if "reference.scale" in found and reference.size and reference.all() and np.ptp(reference) == 0:
        yield (
            "reference.amplitude",
            Quantity(reference[0], found["reference.scale"].slots, 1 / reference[0]),
        )
    signal = problem.scenario.disturbance
    name = "disturbance.rms" if isinstance(signal, Random) else "disturbance.amplitude"
    for i, size in enumerate(sizes(signal, problem.plant.m)):
        if size:
            yield (
                f"{name}[{i}]",
                Quantity(
                    size, found[f"disturbance.scale[{i}]"].slots, 1 / size, LEAST.get(name, -np.inf)
                ),
            )


def sizes(signal: Signal | Random | None, channels: int) -> Floats:
    """The amplitude (or rms) of each channel that a signal is proportional to; none where it has none."""
    match signal:
        case Sine(amplitude=size, offset=rest) | Step(amplitude=size, before=rest) if not np.any(
            rest
        ):
            pass
        case Trapezoid(amplitude=size) | Random(rms=size):
            pass
        case _:
            return np.empty(0)
    return np.broadcast_to(np.asarray(size, float).ravel(), channels)


def matching(address: str, found: Iterable[str]) -> list[str]:
    """The names that an address stands for: without an index all entries, with `:` all values of that index."""
    key, index = stem(address), address[len(stem(address)) :]
    pattern = re.escape(key) + (re.escape(index).replace(":", r"\d+") if index else r"(\[.*\])?")
    return [name for name in found if re.fullmatch(pattern, name)]
