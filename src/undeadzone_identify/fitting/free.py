"""Free numbers of a scenario: addresses, ranges and starts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.plants.system import System
from undeadzone.scenario.address import (
    Number,
    entries_there,
    find_option_numbers,
    matching,
    similar,
    stem,
    with_value,
)
from undeadzone.scenario.schema import Scenario
from undeadzone.signals.exosystem import Random

TABLES: Final = ("plant", "sensor", "actuator", "disturbance")  # whose numbers may be fitted
PARAMETERS: Final = "plant.parameters."
WIDTHS: Final = ("sensor.right", "sensor.left", "actuator.right", "actuator.left")
COMPLIANCE: Final = "contact deviation"  # of gears, by which flanks are off their law of contact
HALF: Final = "plant.arm.gears.half"
NOISES: Final = (
    *("sensor.noise", "sensor.noise_before", "disturbance.rms", "disturbance.correlation_time"),
    COMPLIANCE,
)
SIGNED: Final = ("plant.A", "plant.B", "plant.C", "plant.companion")  # entries of any sign
DELAY: Final = "plant.delay"
FIXED: Final = ("plant.x0", "plant.x_eq", "plant.u_eq")  # not by --free
FAR: Final = 10.0  # default range of a positive number, over and below its value
LOUD: Final = 30.0  # the same of noises
WIDE: Final = 3.0  # default range of a signed number about its value, in its size
LOGARITHMIC: Final = 3.0  # ratio of the ends of a range from which it is searched in logarithms
LASTING: Final = 12.5  # default correlation time of a disturbance [samples]
EXAMPLE: Final = "--free plant.mass,sensor.right=0..0.5"


class FreeNumber(NamedTuple):
    """Number that is fitted.

    Attributes:
        name: its address, or x(0) of a log.
        low, high: ends of its range.
        start: first value of the search.
        std: deviation of its normal prior about `start` (inf: its range alone).
        is_log: whether it is searched in logarithms.
    """

    name: str
    low: float
    high: float
    start: float
    std: float = math.inf
    is_log: bool = False

    @property
    def is_noise(self) -> bool:
        """Return whether it is a noise, which is fitted last."""
        return stem(self.name) in NOISES

    @property
    def is_start(self) -> bool:
        """Return whether it is an entry of x(0)."""
        return self.name.startswith("x0[")


def free_within(
    name: str, low: float, high: float, start: float, std: float = math.inf
) -> FreeNumber:
    """Return a number that is free within a range, from its middle if its start lies outside."""
    is_log = low > 0 and high / low > LOGARITHMIC
    if not low <= start <= high:
        start = math.sqrt(low * high) if is_log else (low + high) / 2
    return FreeNumber(name, low, high, start, std, is_log)


def find_numbers(scenario: Scenario, system: System) -> dict[str, Number]:
    """Return every number of a scenario that may be fitted, by address."""
    known = find_option_numbers(scenario, TABLES)
    values = system.params if system.names else ()
    for name, value in zip(system.names, values, strict=True):
        known.setdefault(f"{PARAMETERS}{name}", Number(float(value), False))
    return {name: number for name, number in known.items() if stem(name) not in FIXED}


def complete_tables(scenario: Scenario, free: Mapping[str, Any]) -> tuple[Scenario, list[str]]:
    """Return the scenario with the tables that free numbers need, and what is free besides.

    A log shows a disturbance and noise, so that without a value they are free.

    Raises:
        InputError: the disturbance is no random one.
    """
    if scenario.disturbance is not None and not isinstance(scenario.disturbance, Random):
        raise InputError(
            'disturbance.kind: expected "random", whose size a log can show, found '
            f'"{scenario.disturbance.__struct_config__.tag}". Put a known one into the inputs of '
            "the log"
        )
    besides = []
    if scenario.disturbance is None:
        lasting = LASTING * scenario.simulation.step
        table = {"kind": "random", "rms": 0.0, "correlation_time": lasting}
        scenario = with_value(scenario, "disturbance", table)
        besides.append("disturbance.rms")
    if not np.any(scenario.sensor.noise) and not np.any(scenario.sensor.noise_before):
        besides.append("sensor.noise")
    if scenario.actuator is None and any(name.startswith("actuator.") for name in free):
        scenario = with_value(scenario, "actuator", {"right": 0.0, "left": 0.0})
    return scenario, [name for name in besides if name not in map(stem, free)]


def expand_address(address: str, known: Mapping[str, Number]) -> list[str]:
    """Return the numbers that an address stands for. Raises InputError."""
    full = address
    parameter = f"{PARAMETERS}{address.removeprefix('plant.')}"
    if parameter in known:
        full = parameter
    names = [name for name in matching(full, known) if known[name].value is not None]
    if not names:
        extent = entries_there(full, known)
        advice = f"There is {extent}" if extent else similar(full, known, "There are")
        raise InputError(f"free: {address!r} is not a number of the scenario. {advice}")
    for name in names:
        if known[name].whole and name != DELAY:
            raise InputError(f"free: {name} cannot be fitted: it is a whole number")
    return names


class Sizes(NamedTuple):
    """Sizes from which default ranges follow.

    Attributes:
        z: largest width that is searched.
        y, u: rms of readings and inputs.
    """

    z: float
    y: float
    u: float


def build_free_number(name: str, value: float, given: Any, sizes: Sizes) -> FreeNumber:
    """Return a number with its range.

    Args:
        name: its address.
        value: in the scenario.
        given: what the user gives: None, (low, high), or (start, low, high[, std]).
        sizes: of the logs.

    Raises:
        InputError: no range follows from a value of 0, or it is not one.
    """
    if given is None:
        given = _default_range(name, value, sizes)
    try:
        given = np.array(given, float)
    except (TypeError, ValueError):
        given = np.array(0.0)
    if given.shape not in ((2,), (3,), (4,)):
        raise InputError(
            f"free: {name}: expected None, (lo, hi), (start, lo, hi) or (start, lo, hi, std)"
        )
    start, low, high, std = [value, *given, math.inf][given.size > 2 :][:4]
    if not low < high:
        raise InputError(f"free: {name}: expected a range lo..hi with lo < hi, found {low}..{high}")
    if given.size > 2 and not low <= start <= high:
        raise InputError(f"free: {name}: the start {start:g} lies outside of {low:g}..{high:g}")
    return free_within(name, float(low), float(high), float(start), float(std))


def _default_range(name: str, value: float, sizes: Sizes) -> tuple[float, float]:
    """Return the range of a number without one. Raises InputError."""
    place = stem(name)
    if place in WIDTHS:
        largest = sizes.z if place.startswith("sensor") else 3 * sizes.u
        return 0.0, max(largest, 2 * value)
    if place in NOISES:
        size = value or {"s": sizes.y, "d": sizes.u}[place[0]] / LOUD
        return size / LOUD, size * LOUD
    if value == 0:
        raise InputError(
            f"free: {name}: is 0 in the scenario, so that no range follows from it. Give one: "
            f"{name}=lo..hi"
        )
    if value > 0 and place not in SIGNED:
        return value / FAR, value * FAR
    return value - WIDE * abs(value), value + WIDE * abs(value)
