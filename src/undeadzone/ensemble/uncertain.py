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
    """One number drawn per run; it sets the packed number [params, state] of each slot to a factor times its value."""

    name: str
    spread: CheckedDistribution
    slots: tuple[tuple[int, float], ...]


def columns(
    entries: dict[str, Distribution], known: dict[str, Quantity], problem: Problem
) -> tuple[UncertainNumber, ...]:
    """What the entries of [ensemble] draw. Raises InputError."""
    found = tuple(
        column
        for address, given in entries.items()
        for column in _drawn(address, given, known, problem)
    )
    owners: dict[int, str] = {}
    for column in found:
        for slot, _ in column.slots:
            if slot in owners:
                raise InputError(
                    f"{entry_name(column.name)}: varies what {owners[slot]} varies already; keep one of them"
                )
            owners[slot] = column.name
    return found


def _drawn(
    address: str, given: Distribution, known: dict[str, Quantity], problem: Problem
) -> list[UncertainNumber]:
    parts = re.sub(r"\s+", "", address).split("+")
    names = [name for part in parts for name in _named(address, part, known, problem)]
    if given.relative:
        fixed = [
            name
            for name in names
            if known[name].nominal == 0 or not math.isfinite(known[name].nominal)
        ]
        if fixed and (len(fixed) == len(names) or set(fixed) & set(parts)):
            raise InputError(
                f"{entry_name(address)}: {fixed[0]} is {known[fixed[0]].nominal:g}, which no factor changes; leave out relative and give values"
            )
        names = [name for name in names if name not in fixed]
    suffix = " (relative)" if given.relative else ""
    groups = [(" + ".join(parts), names)] if given.shared else [(name, [name]) for name in names]
    return [
        _column(address, given, title + suffix, {name: known[name] for name in members})
        for title, members in groups
    ]


def _column(
    address: str, given: Distribution, title: str, members: dict[str, Quantity]
) -> UncertainNumber:
    sizes = {
        name: quantity.nominal if given.relative else 1.0 for name, quantity in members.items()
    }
    floor = max(members[name].least / abs(size) for name, size in sizes.items())
    slots = tuple(
        (slot, quantity.gain * sizes[name])
        for name, quantity in members.items()
        for slot in quantity.slots
    )
    return UncertainNumber(title, spread(address, given, floor), slots)


def _named(address: str, part: str, known: dict[str, Quantity], problem: Problem) -> list[str]:
    """The quantities that one address stands for. Raises InputError."""
    if names := matching(part, known):
        return names
    stems = sorted({stem(name) for name in known})
    if stem(part) in stems:
        there = [name for name in known if stem(name) == stem(part)]
        raise InputError(
            f"{entry_name(address)}: no entry {part}; there is {there[0]}{f' to {there[-1]}' if there[1:] else ' alone'}"
        )
    if advice := _advice(part, problem):
        raise InputError(f"{entry_name(address)}: {advice}")
    near = difflib.get_close_matches(stem(part), stems, 1)
    choice = f"did you mean {near[0]!r}?" if near else f"what can: {', '.join(stems)}"
    raise InputError(f"{entry_name(address)}: nothing of that name can vary; {choice}")


def _advice(part: str, problem: Problem) -> str | None:
    """What to do instead, for addresses that this scenario lacks."""
    match stem(part).split("."):
        case ["reference", *_] if problem.model.nonlinear:
            return "the feedforward of a nonlinear plant is not proportional to its reference, which therefore cannot vary"
        case ["reference", "amplitude"]:
            return "the reference has no single amplitude about 0; vary reference.scale, a factor on the whole of it"
        case ["disturbance", *_] if problem.scenario.disturbance is None:
            return 'there is no disturbance to scale; add [disturbance], for a bias with kind = "step" and an amplitude of any size but 0'
        case ["disturbance", "amplitude" | "rms" | "bias" | "offset"]:
            return (
                "the disturbance is proportional to no such number, or that is 0; give it an amplitude or rms of any size but 0 and nothing else "
                "(a bias: a step), or vary disturbance.scale, a factor on the whole of it"
            )
        case ["model", *_]:
            return "the design stays as it is for the nominal [model]; vary plant.A, the truth, or observer.model.A, what the observer believes"
        case ["plant", "second_order" | "companion" | "transfer_function" | "integrators", *_]:
            return (
                "vary the entries of the matrices that this form gives: plant.A, plant.B, plant.C"
            )
    return None
