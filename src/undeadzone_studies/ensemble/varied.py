"""Addresses of [ensemble] and the packed numbers of the loop that they set in each run.

The slots of the sensor's numbers in the loop are found by building it again with other numbers.
"""

from __future__ import annotations

import math
import re
from typing import Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError
from undeadzone.observers.filtering.actuator import build_with_actuator
from undeadzone.plants.robots.arm import is_signless
from undeadzone.plants.system import plant_pace
from undeadzone.scenario.address import entries_there, index_of, matching, similar, stem
from undeadzone.scenario.encoders import resolve_sensor
from undeadzone.scenario.ensemble_table import (
    POSITIVE,
    TABLE,
    Distribution,
    ValidatedDistribution,
    spread,
)
from undeadzone.scenario.problem import Problem, sensor_of_model
from undeadzone.signals.exosystem import Random, Signal, Sine, Step, Trapezoid
from undeadzone.simulation.loop import Loop
from undeadzone.simulation.packed import pack_problem
from undeadzone.util import tree
from undeadzone.util.arrays import Floats

FIXED: Final = (
    *("h", "controller.tau", "controller.rate"),  # set by the clock, never varied
    *("sensor.limits.low", "sensor.limits.high"),  # sensor.range, if they exist
)
AHEAD: Final = "controller.ahead."  # of the model that a controller moves on over a delay
PARAMETRIC: Final = ("plant", "observer.model", "controller.model")  # hold NAME of parameters
PER_SECOND: Final = ("observer.L", "observer.gamma")  # held per step by the loop of a sampled model
NOT_NEGATIVE: Final = (
    *("sensor.right", "sensor.left", "sensor.play", "sensor.threshold"),
    *("sensor.noise", "sensor.noise_before", "disturbance.rms", "observer.gamma"),
)
ABOVE_ZERO: Final = ("sensor.slope", "sensor.range")  # the lower limit, below 0, by a factor alone
SCALES: Final = {
    "scale.reference": "reference.scale",
    "scale.disturbance": "disturbance.scale",
    "scale.before": "sensor.noise_before",
    "scale.after": "sensor.noise",
}
WIDTHS: Final = ("right", "left", "threshold")  # of a sensor's zone
TINY: Final = 1e-200  # in place of a number that is 0


class Quantity(NamedTuple):
    """Number that may vary.

    Attributes:
        nominal: its value in the scenario, in the scenario's unit
        slots: its slots among the packed numbers [params, state] of the loop
        gain: the packed numbers are gain times the value
        least: the least value that it may have
    """

    nominal: float
    slots: tuple[int, ...]
    gain: float = 1.0
    least: float = -np.inf


class UncertainNumber(NamedTuple):
    """Number that is drawn for each run.

    Attributes:
        name: its column, such as `sensor.right[0]` or `plant.A[1,0] (relative)`
        spread: its distribution
        slots: pairs (slot of the packed [params, state], factor) (it sets each slot to the factor
            times its value)
    """

    name: str
    spread: ValidatedDistribution
    slots: tuple[tuple[int, float], ...]


def collect_quantities(problem: Problem, loop: Loop, nominal: Floats) -> dict[str, Quantity]:
    """Return every quantity of a problem, by address, in the order of the loop's packed
    numbers.

    Args:
        problem: the scenario, checked and built
        loop: its loop
        nominal: the packed params, with plants that are held sampled in continuous time
    """
    of_sensor = _find_sensor_slots(problem, loop)
    renamed = {slots[0]: address for address, slots in of_sensor.items()}
    fixed = [*FIXED, *_list_unused_scales(problem)]
    by_address: dict[str, Quantity] = {}
    for slot, (name, value) in enumerate(
        zip(tree.number_addresses(loop.params), nominal, strict=True)
    ):
        is_fixed = stem(name) in fixed or name.startswith(AHEAD)
        if is_fixed and slot not in renamed:
            continue
        address = renamed.get(slot) or _scenario_address(problem, name)
        slots = of_sensor.get(address, (slot,))
        gain = 1.0
        if stem(name) in PER_SECOND and problem.model.Ts is not None:
            gain = problem.model.Ts
        by_address[address] = Quantity(value / gain, slots, gain, _least_value(problem, address))
    for i, x in enumerate(problem.x0):
        by_address[f"plant.x0[{i}]"] = Quantity(x, (nominal.size + i,))
    return by_address | _collect_amplitudes(problem, by_address)


def _find_sensor_slots(problem: Problem, loop: Loop) -> dict[str, tuple[int, ...]]:
    """Return the slots in the packed params of each width, gap, threshold and limit of the
    sensor, by address.

    The sensor's own place comes first, then those of its observer that hold the same number: widths
    if it knows them, gaps unless [model] gives them. They are found in a loop that is built with
    other numbers, all of them different.
    """
    others = _perturb_sensor(problem)
    scenario = problem.scenario
    model = problem.model
    sensor = msgspec.structs.replace(scenario.sensor, **others)
    assumed = sensor_of_model(msgspec.structs.replace(scenario, sensor=sensor))
    read = problem.flow, scenario.simulation.step, plant_pace(problem.flow.linear)
    observer = build_with_actuator(
        scenario.observer, model, resolve_sensor(assumed, *read), problem.belief
    )
    changed = problem._replace(sensor=resolve_sensor(sensor, *read), observer=observer)
    _, params = pack_problem(changed, loop)
    places = {}
    for key, numbers in others.items():
        for index, number in np.ndenumerate(numbers):
            printed_index = index[1:] if numbers.shape == (1, 2) else index
            slots = tuple(np.flatnonzero(params == number).tolist())
            if slots and np.isfinite(number):
                places[f"sensor.{key}[{','.join(map(str, printed_index))}]"] = slots
    return places


def _perturb_sensor(problem: Problem) -> dict[str, Floats]:
    """Return numbers of the sensor by key, hardly smaller than its own and all of them
    different.
    """
    sensor = problem.sensor
    own = {name: getattr(sensor, name) for name in WIDTHS}
    if problem.plant.gears is not None:
        own = {}
    if sensor.limits is not None:
        own["range"] = np.stack([sensor.low, sensor.high], axis=1)
    if sensor.play is not None:
        own["play"] = np.stack([sensor.play.right, sensor.play.left], axis=1)
    rng = np.random.default_rng(0)
    others = {}
    for key, numbers in own.items():
        shares = rng.uniform(0.0, 1e-3, numbers.shape)
        others[key] = np.where(numbers == 0, TINY * shares, numbers * (1 - shares))
    return others


def _list_unused_scales(problem: Problem) -> list[str]:
    """Return the scales without effect in a problem.

    The targets of a nonlinear model are not proportional to the reference.
    """
    meaningless = []
    if problem.model.nonlinear:
        meaningless.append("scale.reference")
    if problem.scenario.disturbance is None:
        meaningless.append("scale.disturbance")
    if problem.plant.gears is not None:  # encoders have no zone
        meaningless += [f"sensor.{name}" for name in WIDTHS]
        meaningless += [f"observer.{name}" for name in WIDTHS]
    return meaningless


def _scenario_address(problem: Problem, name: str) -> str:
    """Return the address in the scenario of a packed number of the loop."""
    key = stem(name)
    index = index_of(name)
    if key in PARAMETRIC:
        return f"{key}.parameters.{problem.plant.names[int(index[1:-1])]}"
    return SCALES.get(key, key) + index


def _least_value(problem: Problem, address: str) -> float:
    """Return the least value that the number at an address may have."""
    _, _, parameter = address.partition(".parameters.")
    if parameter and problem.plant.arm is not None and is_signless(parameter):
        return 0.0
    if stem(address) in ABOVE_ZERO:
        return POSITIVE
    return 0.0 if stem(address) in NOT_NEGATIVE else -np.inf


def _collect_amplitudes(problem: Problem, by_address: dict[str, Quantity]) -> dict[str, Quantity]:
    """Return the nonzero amplitudes of reference and disturbance that have a single size."""
    amplitudes: dict[str, Quantity] = {}
    reference = channel_amplitudes(problem.scenario.reference, len(problem.tracked))
    one_size = reference.size and reference.all() and np.ptp(reference) == 0
    if "reference.scale" in by_address and one_size:
        slots = by_address["reference.scale"].slots
        amplitudes["reference.amplitude"] = Quantity(reference[0], slots, 1 / reference[0])
    signal = problem.scenario.disturbance
    name = "disturbance.rms" if isinstance(signal, Random) else "disturbance.amplitude"
    for i, size in enumerate(channel_amplitudes(signal, problem.plant.m)):
        if size:
            slots = by_address[f"disturbance.scale[{i}]"].slots
            amplitudes[f"{name}[{i}]"] = Quantity(
                size, slots, 1 / size, _least_value(problem, name)
            )
    return amplitudes


def channel_amplitudes(signal: Signal | Random | None, channels: int) -> Floats:
    """Return the amplitude (or rms) of each channel that a signal is proportional to, or no
    numbers.
    """
    rest: npt.ArrayLike = 0.0  # part of the signal that is not proportional to its size
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


def resolve_entries(
    entries: dict[str, Distribution], known: dict[str, Quantity], problem: Problem
) -> tuple[UncertainNumber, ...]:
    """Return the numbers that the entries of [ensemble] draw.

    Args:
        entries: distributions by address
        known: what may vary, by address
        problem: the scenario, checked and built

    Raises:
        InputError
    """
    numbers: list[UncertainNumber] = []
    for address, distribution in entries.items():
        numbers += _numbers_of_entry(address, distribution, known, problem)
    owners: dict[int, str] = {}
    for number in numbers:
        for slot, _ in number.slots:
            if slot in owners:
                raise InputError(
                    f"{TABLE.entry_name(number.name)}: varies what {owners[slot]} varies already. "
                    "Keep one of them"
                )
            owners[slot] = number.name
    return tuple(numbers)


def _numbers_of_entry(
    address: str, distribution: Distribution, known: dict[str, Quantity], problem: Problem
) -> list[UncertainNumber]:
    """Return the numbers that an entry draws: a single number if shared, else a number per
    quantity.
    """
    parts = re.sub(r"\s+", "", address).split("+")
    names: list[str] = []
    for part in parts:
        names += _quantities_of_part(address, part, known, problem)
    suffix = ""
    if distribution.relative:
        names = _select_scalable(address, parts, names, known)
        suffix = " (relative)"
    else:
        _require_settable(address, names, known)
    groups = [(name, [name]) for name in names]
    if distribution.shared:
        groups = [(" + ".join(parts), names)]
    numbers = []
    for title, members in groups:
        least = []
        slots = []
        for quantity in [known[name] for name in members]:
            size = quantity.nominal if distribution.relative else 1.0
            least.append(quantity.least / abs(size))
            slots += [(slot, quantity.gain * size) for slot in quantity.slots]
        law = spread(address, distribution, max(least))
        numbers.append(UncertainNumber(title + suffix, law, tuple(slots)))
    return numbers


def _require_settable(address: str, names: list[str], known: dict[str, Quantity]) -> None:
    """Raise InputError for a quantity to which no values can be given."""
    for name in names:
        if known[name].nominal < 0 < known[name].least:
            raise InputError(
                f"{TABLE.entry_name(address)}: {name} is negative and varies by a factor alone. "
                "Set relative = true and give factors"
            )


def _select_scalable(
    address: str, parts: list[str], names: list[str], known: dict[str, Quantity]
) -> list[str]:
    """Return the names whose quantities a factor changes: those that are finite and not 0.

    Raises InputError if none is left, or for a quantity that the address names by itself.
    """
    changed = [n for n in names if known[n].nominal and math.isfinite(known[n].nominal)]
    fixed = [name for name in names if name not in changed]
    if fixed and (not changed or set(fixed) & set(parts)):
        raise InputError(
            f"{TABLE.entry_name(address)}: {fixed[0]} is {known[fixed[0]].nominal:g}, which no "
            "factor changes. Leave out relative and give values"
        )
    return changed


def _quantities_of_part(
    address: str, part: str, known: dict[str, Quantity], problem: Problem
) -> list[str]:
    """Return the quantities of a part of an address. Raises InputError."""
    if names := matching(part, known):
        return names
    why = _advice_for_address(part, problem)
    if extent := entries_there(part, known):
        why = f"no entry {part}. There is {extent}"
    why = why or f"nothing of that name can vary. {similar(part, known, 'These can:')}"
    raise InputError(f"{TABLE.entry_name(address)}: {why}")


def _advice_for_address(part: str, problem: Problem) -> str | None:
    """Return advice for an address that this scenario lacks, or None."""
    match stem(part).split("."):
        case ["reference", *_] if problem.model.nonlinear:
            return (
                "the feedforward of a nonlinear plant is not proportional to its reference, "
                "which therefore cannot vary"
            )
        case ["reference", "amplitude"]:
            return (
                "the reference has no single amplitude about 0. Vary reference.scale, "
                "a factor on the whole of it"
            )
        case ["disturbance", *_] if problem.scenario.disturbance is None:
            return (
                "there is no disturbance to scale; add [disturbance], for a bias with "
                'kind = "step" and an amplitude of any size but 0'
            )
        case ["disturbance", "amplitude" | "rms" | "bias" | "offset"]:
            return (
                "the disturbance is proportional to no such number, or that is 0. Give it an "
                "amplitude or rms of any size but 0 and nothing else (a bias: a step), "
                "or vary disturbance.scale, a factor on the whole of it"
            )
        case ["model", *_]:
            return (
                "the design stays as it is for the nominal [model]. Vary plant.A, the truth, "
                "or observer.model.A, what the observer believes"
            )
        case ["plant", "second_order" | "companion" | "transfer_function" | "integrators", *_]:
            return (
                "vary the entries of the matrices that this form gives: plant.A, plant.B, plant.C"
            )
    return None
