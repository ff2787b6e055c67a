"""A method entered into a scenario: in the place of its observer, with what it may know."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import msgspec

from undeadzone.arena.methods import NOTHING, Knobs, Method, Numbers, Options, middle
from undeadzone.arena.prior_knowledge import UNITS, PriorKnowledge, Setting, situation
from undeadzone.arena.tuned_file import load
from undeadzone.scenario.schema import Scenario


def numbers(path: Path | None = None) -> Numbers:
    """The numbers of the knobs, by method, as `undeadzone arena --tune` found them.

    Args:
        path: of a file of one's own; None: those that come with the package.

    Raises:
        FileError: the file cannot be read.
    """
    if path is None:
        with as_file(files("undeadzone.arena") / "tuned.toml") as own:
            return numbers(own)
    return {name: entry.knobs for name, entry in load(path).methods.items()}


def entered(method: Method, ground: Setting, numbers: Knobs = NOTHING) -> Scenario:
    """The scenario with a method in the place of its observer.

    The method takes the place of the controller too if it has its own.

    Args:
        method: what is entered.
        ground: the scenario, and what may be known of it.
        numbers: of the method's knobs, by address; those that lack are in the middle of their
            range.

    Raises:
        InputError: or a subclass.
    """
    if method.continuous and ground.scenario.simulation.time == "sampled":
        ground = _in_continuous_time(ground)
    scenario, prior = ground
    values = middle(method)
    for address, value in numbers.items():
        if address in method.knobs:
            values[address] = value
    knobs = {
        address: value * UNITS[method.knobs[address].unit](prior)
        for address, value in values.items()
    }
    derived = method.derived(prior, knobs) if method.derived else NOTHING
    options = {**knobs, **method.fixed, **derived}
    parts = {"observer": _options(method.observer, "observer", prior, options)}
    if method.controller:
        parts["controller"] = _options(method.controller, "controller", prior, options)
    if method.informed:
        # A known disturbance of the input is cancelled there: what is left is a run without it.
        parts |= {"model": None, "disturbance": None}
    return msgspec.structs.replace(scenario, **parts)


def _in_continuous_time(ground: Setting) -> Setting:
    """The same scenario in continuous time, and what is known of it."""
    simulation = msgspec.structs.replace(ground.scenario.simulation, time="continuous")
    return situation(msgspec.structs.replace(ground.scenario, simulation=simulation))


def _options(kind: Any, part: str, prior: PriorKnowledge, options: Mapping[str, Any]) -> Any:
    """The options of a part.

    They are what is known, by the names that the part has for it, then what has its address.

    Args:
        kind: the struct of the options.
        part: observer or controller.
        prior: what is known.
        options: of all parts, by address.
    """
    names = {field.name for field in msgspec.structs.fields(kind)}
    prefix = f"{part}."
    known = _claims(part, names, prior)
    chosen = {name: value for name, value in known.items() if name in names}
    for address, value in options.items():
        if address.startswith(prefix):
            chosen[address.removeprefix(prefix)] = value
    return kind(**chosen)


def _claims(part: str, names: set[str], prior: PriorKnowledge) -> Options:
    """What is known, by the names that options have for it."""
    p = prior.model.p
    every = msgspec.structs.asdict(prior.declared)
    claims = {name: value for name, value in every.items() if value is not None}
    if "correlation_time" not in names:
        claims.pop("disturbance", None)  # of another colour there
    guess = prior.widths.mean(axis=1).reshape(2, p).T
    most = prior.widths[:, 1].reshape(2, p).max(axis=0)
    return claims | {
        "widths0": guess,
        "width_max": most,
        "reach": prior.reach if part == "controller" else prior.reach[0],
        "scale": prior.reach[0],
    }
