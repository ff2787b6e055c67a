"""From the addresses of [ensemble] to columns: the numbers that are drawn for each run."""

from __future__ import annotations

import difflib
import math
import re
from typing import NamedTuple

from undeadzone.ensemble.addresses import Quantity, matching, stem
from undeadzone.errors import InputError
from undeadzone.scenario.ensemble_table import CheckedDistribution, Distribution, entry_name, spread
from undeadzone.scenario.problem import Problem


class UncertainNumber(NamedTuple):
    """One number that is drawn for each run.

    Attributes:
        name: its column, such as `sensor.right[0]` or `plant.A[1,0] (relative)`
        spread: its distribution
        slots: pairs (slot of the packed [params, state], factor); it sets each slot to the factor
            times its value
    """

    name: str
    spread: CheckedDistribution
    slots: tuple[tuple[int, float], ...]


def uncertain_numbers(
    entries: dict[str, Distribution], known: dict[str, Quantity], problem: Problem
) -> tuple[UncertainNumber, ...]:
    """What the entries of [ensemble] draw.

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
                    f"{entry_name(number.name)}: varies what {owners[slot]} varies already; "
                    "keep one of them"
                )
            owners[slot] = number.name
    return tuple(numbers)


def _numbers_of_entry(
    address: str, distribution: Distribution, known: dict[str, Quantity], problem: Problem
) -> list[UncertainNumber]:
    """What one entry draws: one number if its draw is shared, else one for each quantity."""
    parts = re.sub(r"\s+", "", address).split("+")
    names: list[str] = []
    for part in parts:
        names += _named(address, part, known, problem)
    suffix = ""
    for name in names:
        if known[name].nominal < 0 < known[name].least and not distribution.relative:
            raise InputError(
                f"{entry_name(address)}: {name} is negative and varies by a factor alone; set "
                "relative = true and give factors"
            )
    if distribution.relative:
        names = _with_factors(address, parts, names, known)
        suffix = " (relative)"
    groups = [(name, [name]) for name in names]
    if distribution.shared:
        groups = [(" + ".join(parts), names)]
    numbers = []
    for title, members in groups:
        quantities = {name: known[name] for name in members}
        numbers.append(_number(address, distribution, title + suffix, quantities))
    return numbers


def _with_factors(
    address: str, parts: list[str], names: list[str], known: dict[str, Quantity]
) -> list[str]:
    """The names whose quantities a factor changes: not those that are 0 or infinite.

    Raises InputError if none is left, or for a quantity that the address names by itself.
    """
    fixed = []
    for name in names:
        nominal = known[name].nominal
        if nominal == 0 or not math.isfinite(nominal):
            fixed.append(name)
    if fixed and (len(fixed) == len(names) or set(fixed) & set(parts)):
        raise InputError(
            f"{entry_name(address)}: {fixed[0]} is {known[fixed[0]].nominal:g}, which no factor "
            "changes; leave out relative and give values"
        )
    return [name for name in names if name not in fixed]


def _number(
    address: str, distribution: Distribution, title: str, members: dict[str, Quantity]
) -> UncertainNumber:
    """The number that sets some quantities: their value, or a factor on each nominal value."""
    least, slots = [], []
    for quantity in members.values():
        size = quantity.nominal if distribution.relative else 1.0
        least.append(quantity.least / abs(size))
        slots += [(slot, quantity.gain * size) for slot in quantity.slots]
    return UncertainNumber(title, spread(address, distribution, max(least)), tuple(slots))


def _named(address: str, part: str, known: dict[str, Quantity], problem: Problem) -> list[str]:
    """The quantities that one part of an address stands for. Raises InputError."""
    if names := matching(part, known):
        return names
    stems = sorted({stem(name) for name in known})
    if stem(part) in stems:
        there = [name for name in known if stem(name) == stem(part)]
        extent = f"{there[0]} to {there[-1]}" if there[1:] else f"{there[0]} alone"
        raise InputError(f"{entry_name(address)}: no entry {part}; there is {extent}")
    if advice := _advice(part, problem):
        raise InputError(f"{entry_name(address)}: {advice}")
    near = difflib.get_close_matches(stem(part), stems, 1)
    choice = f"did you mean {near[0]!r}?" if near else f"what can: {', '.join(stems)}"
    raise InputError(f"{entry_name(address)}: nothing of that name can vary; {choice}")


def _advice(part: str, problem: Problem) -> str | None:
    """What to do instead, for addresses that this scenario lacks."""
    match stem(part).split("."):
        case ["reference", *_] if problem.model.nonlinear:
            return (
                "the feedforward of a nonlinear plant is not proportional to its reference, "
                "which therefore cannot vary"
            )
        case ["reference", "amplitude"]:
            return (
                "the reference has no single amplitude about 0; vary reference.scale, "
                "a factor on the whole of it"
            )
        case ["disturbance", *_] if problem.scenario.disturbance is None:
            return (
                "there is no disturbance to scale; add [disturbance], for a bias with "
                'kind = "step" and an amplitude of any size but 0'
            )
        case ["disturbance", "amplitude" | "rms" | "bias" | "offset"]:
            return (
                "the disturbance is proportional to no such number, or that is 0; give it an "
                "amplitude or rms of any size but 0 and nothing else (a bias: a step), "
                "or vary disturbance.scale, a factor on the whole of it"
            )
        case ["model", *_]:
            return (
                "the design stays as it is for the nominal [model]; vary plant.A, the truth, "
                "or observer.model.A, what the observer believes"
            )
        case ["plant", "second_order" | "companion" | "transfer_function" | "integrators", *_]:
            return (
                "vary the entries of the matrices that this form gives: plant.A, plant.B, plant.C"
            )
    return None
