"""The numbers of a scenario that may vary, by address, and the packed numbers that they set."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from undeadzone.observers import Oracle
from undeadzone.plants.robots.arm import signless
from undeadzone.plants.system import System
from undeadzone.scenario.ensemble_table import POSITIVE
from undeadzone.scenario.problem import Problem
from undeadzone.signals.exosystem import Random, Signal, Sine, Step, Trapezoid
from undeadzone.simulation.loop import Loop
from undeadzone.support import tree
from undeadzone.support.arrays import LARGEST, Floats

FIXED: Final = ("h", "controller.tau", "controller.rate")  # set by the clock, never varied
PARAMETRIC: Final = ("plant", "observer.model", "controller.model")  # hold NAME of parameters
PER_SECOND: Final = ("observer.L", "observer.gamma")  # held per step by the loop of a sampled model
LEAST: Final = {
    "sensor.right": 0.0,
    "sensor.left": 0.0,
    "sensor.play": 0.0,
    "sensor.threshold": 0.0,
    "sensor.noise": 0.0,
    "sensor.noise_before": 0.0,
    "disturbance.rms": 0.0,
    "observer.gamma": 0.0,
    "sensor.slope": POSITIVE,
    "sensor.range": POSITIVE,  # the lower limit, below 0, by a factor alone
}
LIMITS: Final = {
    "sensor.limits.low": 0,
    "sensor.limits.high": 1,
}  # places in a pair of sensor.range
GAPS: Final = {
    "sensor.gap_right": 0,
    "sensor.gap_left": 1,
}  # places in a pair of sensor.play
SCALES: Final = {
    "scale.reference": "reference.scale",
    "scale.disturbance": "disturbance.scale",
    "scale.before": "sensor.noise_before",
    "scale.after": "sensor.noise",
}


class Quantity(NamedTuple):
    """A number that may vary.

    Attributes:
        nominal: its value in the scenario, in the scenario's unit
        slots: where it stands among the packed numbers [params, state] of the loop
        gain: the packed numbers are gain times the value
        least: the least value that it may have
    """

    nominal: float
    slots: tuple[int, ...]
    gain: float = 1.0
    least: float = -np.inf


def stem(name: str) -> str:
    """An address without its index."""
    return name.partition("[")[0]


def index_of(name: str) -> str:
    """The index of an address with its brackets; empty if it has none."""
    return name[len(stem(name)) :]


def quantities(problem: Problem, loop: Loop) -> dict[str, Quantity]:
    """Every quantity of a problem, by address, in the order of the loop's packed numbers."""
    size = tree.size(loop.params)
    slots = dict(zip(tree.names(loop.params), range(size), strict=True))
    values = tree.pack(flowing(problem, loop))
    absent = _absent(problem)
    by_address: dict[str, Quantity] = {}
    for (name, slot), value in zip(slots.items(), values, strict=True):
        key = stem(name)
        if key in FIXED or key in absent or (key in LIMITS and abs(value) == LARGEST):
            continue
        address = _address(problem, name)
        gain = 1.0
        if key in PER_SECOND and problem.model.Ts is not None:
            gain = problem.model.Ts
        all_slots = (slot, *_observer_copies(problem, name, slots))
        by_address[address] = Quantity(value / gain, all_slots, gain, _least(problem, address))
    for i, x in enumerate(problem.x0):
        by_address[f"plant.x0[{i}]"] = Quantity(x, (size + i,))
    return by_address | _amplitudes(problem, by_address)


def flowing(problem: Problem, loop: Loop) -> Any:
    """The loop's params with the plant's and the observer's model in continuous time."""
    observer = loop.params.observer
    if hasattr(observer, "model"):
        observer = observer._replace(model=_flow(problem.model, observer.model))
    return loop.params._replace(plant=_flow(problem.plant, loop.params.plant), observer=observer)


def _flow(system: System, params: Any) -> Any:
    """Numbers of a system, with its matrices in continuous time where it has such."""
    if system.nonlinear or system.flow is None:
        return params
    return params._replace(**system.flow._asdict())


def _address(problem: Problem, name: str) -> str:
    """The address in the scenario of a packed number of the loop."""
    key, index = stem(name), index_of(name)
    if key in PARAMETRIC:
        return f"{key}.parameters.{problem.plant.names[int(index[1:-1])]}"
    if key in SCALES:
        return SCALES[key] + index
    pairs = LIMITS | GAPS
    if key in pairs:
        output = index[1:-1] + "," if problem.plant.p > 1 else ""
        pair = "sensor.range" if key in LIMITS else "sensor.play"
        return f"{pair}[{output}{pairs[key]}]"
    return name


def _least(problem: Problem, address: str) -> float:
    """The least value that the number at an address may have."""
    _, is_parameter, parameter = address.partition(".parameters.")
    if is_parameter and problem.plant.arm is not None and signless(parameter):
        return 0.0
    return LEAST.get(stem(address), -np.inf)


def _absent(problem: Problem) -> list[str]:
    """The scales that mean nothing for a problem.

    The targets of a nonlinear model are not proportional to the reference.
    """
    absent = []
    if problem.model.nonlinear:
        absent.append("scale.reference")
    if problem.scenario.disturbance is None:
        absent.append("scale.disturbance")
    return absent


def _observer_copies(problem: Problem, name: str, slots: dict[str, int]) -> list[int]:
    """Where the observer holds its own copy of a packed number of the sensor.

    It copies the threshold and the range, and the gaps ahead of a dead zone unless [model] says
    what they are; the oracle copies the widths too.
    """
    of_play = problem.sensor.kind == "play"
    copies = {
        "sensor.threshold": "observer.motion.threshold" if of_play else "observer.threshold",
        "sensor.limits.low": "observer.ends.low",
        "sensor.limits.high": "observer.ends.high",
    }
    if isinstance(problem.scenario.observer, Oracle):
        copies |= {"sensor.right": "observer.right0", "sensor.left": "observer.left0"}
    key, index = stem(name), index_of(name)
    model = problem.scenario.model
    if key in GAPS and (model is None or model.play is None):
        place = int(index[1:-1]) + GAPS[key] * problem.plant.p
        copies[key], index = "observer.gaps.middle", f"[{place}]"
    if key not in copies:
        return []
    copy = copies[key] + index
    return [slots[copy]] if copy in slots else []


def _amplitudes(problem: Problem, by_address: dict[str, Quantity]) -> dict[str, Quantity]:
    """The amplitudes of reference and disturbance that have one size, which is not 0."""
    amplitudes: dict[str, Quantity] = {}
    reference = sizes(problem.scenario.reference, len(problem.tracked))
    one_size = reference.size and reference.all() and np.ptp(reference) == 0
    if "reference.scale" in by_address and one_size:
        slots = by_address["reference.scale"].slots
        amplitudes["reference.amplitude"] = Quantity(reference[0], slots, 1 / reference[0])
    signal = problem.scenario.disturbance
    name = "disturbance.rms" if isinstance(signal, Random) else "disturbance.amplitude"
    least = LEAST.get(name, -np.inf)
    for i, size in enumerate(sizes(signal, problem.plant.m)):
        if size:
            slots = by_address[f"disturbance.scale[{i}]"].slots
            amplitudes[f"{name}[{i}]"] = Quantity(size, slots, 1 / size, least)
    return amplitudes


def sizes(signal: Signal | Random | None, channels: int) -> Floats:
    """The amplitude (or rms) of each channel that a signal is proportional to; none without one."""
    rest: npt.ArrayLike = (
        0.0  # what the signal has besides the part that is proportional to its size
    )
    match signal:
        case Sine(amplitude=size, offset=rest) | Step(amplitude=size, before=rest):
            pass
        case Trapezoid(amplitude=size) | Random(rms=size):
            pass
        case _:
            return np.empty(0)
    if np.any(rest):
        return np.empty(0)
    return np.broadcast_to(np.asarray(size, float).ravel(), channels)


def matching(address: str, names: Iterable[str]) -> list[str]:
    """The names that an address stands for.

    Without an index it stands for all entries, with `:` for all values of that index.
    """
    pattern = re.escape(stem(address))
    index = index_of(address)
    if index:
        pattern += re.escape(index).replace(":", r"\d+")
    else:
        pattern += r"(\[.*\])?"
    return [name for name in names if re.fullmatch(pattern, name)]
