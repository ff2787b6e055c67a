"""Entry of a method into a scenario: in place of its observer, with its prior information."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from undeadzone.errors import InputError
from undeadzone.nonlinearities.actuator import SIDES, Belief
from undeadzone.observers import FullState
from undeadzone.observers.filtering.actuator import ESTIMATORS
from undeadzone.scenario.problem import describe_actuator
from undeadzone.scenario.schema import Model, Scenario
from undeadzone_arena.contest.methods import (
    NOTHING,
    PARTS,
    Knobs,
    Method,
    Numbers,
    Options,
    middle_knobs,
)
from undeadzone_arena.contest.prior_knowledge import UNITS, PriorKnowledge, Setting, build_setting
from undeadzone_arena.contest.tuned_file import load_tuned

OWN = ("tuned.toml", "tuned_both_ends.toml")  # of --tune, and of --tune --set both_ends


def read_knob_numbers(path: Path | None = None) -> Numbers:
    """Read the numbers of the knobs, by method, that `undeadzone arena --tune` found.

    Args:
        path: of a file of one's own (None: those that come with the package).

    Raises:
        FileError: the file cannot be read.
    """
    if path is None:
        found: dict[str, Knobs] = {}
        for name in OWN:
            with as_file(files("undeadzone_arena.contest") / name) as own:
                found |= read_knob_numbers(own)
        return found
    return {name: entry.knobs for name, entry in load_tuned(path).methods.items()}


def enter_method(method: Method, ground: Setting, numbers: Knobs = NOTHING) -> Scenario:
    """Return the scenario with a method in place of its observer.

    The method takes the place of the controller too if it has its own.

    Args:
        method: the method to enter.
        ground: the scenario, and what may be known of it.
        numbers: of the method's knobs, by address (missing ones are in the middle of their range).

    Raises:
        InputError: or a subclass.
    """
    if method.continuous and ground.scenario.simulation.time == "sampled":
        ground = _to_continuous_time(method, ground)
    scenario, prior = ground
    if method.compensator and scenario.actuator is None:
        raise InputError(
            "actuator: this method is for a dead zone of an actuator, and there is none"
        )
    values = middle_knobs(method)
    for address, value in numbers.items():
        if address in method.knobs:
            values[address] = value
    knobs = {
        address: value * UNITS[method.knobs[address].unit](prior)
        for address, value in values.items()
    }
    derived = method.derived(prior, knobs) if method.derived else NOTHING
    options = {**knobs, **method.fixed, **derived}
    parts: dict[str, Any] = {"model": _method_model(method, scenario, prior)}
    for part in PARTS:
        kind = getattr(method, part)
        if kind is not None:
            parts[part] = _part_options(kind, part, prior, options)
    if method.informed:
        # A known disturbance of the input is cancelled there, which leaves a run without it.
        parts |= {"model": None, "disturbance": None}
    return msgspec.structs.replace(scenario, **parts)


def _method_model(method: Method, scenario: Scenario, prior: PriorKnowledge) -> Model | None:
    """Return the scenario's model with the method's assumptions on the actuator.

    A line to compare with knows it. A method that estimates widths gets their ranges, another one
    the middle of these.
    """
    model = scenario.model
    given = describe_actuator(scenario)
    if method.reference:
        return None if model is None else msgspec.structs.replace(model, actuator=None)
    estimates = method.observer.__struct_config__.tag in ESTIMATORS
    if model is None or given is None or prior.actuator is None or estimates:
        return model
    middles = {side: getattr(prior.actuator.drive, side).tolist() for side in SIDES}
    plain = msgspec.structs.replace(given, **middles)
    return msgspec.structs.replace(model, actuator=plain)


def _to_continuous_time(method: Method, ground: Setting) -> Setting:
    """Convert a setting to continuous time."""
    parts = {
        "simulation": msgspec.structs.replace(ground.scenario.simulation, time="continuous"),
        "model": _method_model(method, *ground),
        "observer": FullState(),  # one that is there in continuous time
        "declared": ground.known.declared,
    }
    return build_setting(msgspec.structs.replace(ground.scenario, **parts))


def _part_options(kind: Any, part: str, prior: PriorKnowledge, options: Mapping[str, Any]) -> Any:
    """Return the options of a part.

    They are the prior information, by the names of the part's options, then the options with its
    address.

    Args:
        kind: the struct of the options.
        part: observer or controller.
        prior: prior information.
        options: of all parts, by address.

    Raises:
        InputError: an option that the part needs is not known.
    """
    names = {field.name for field in msgspec.structs.fields(kind)}
    prefix = f"{part}."
    known = _options_from_prior(part, names, prior)
    chosen = {name: value for name, value in known.items() if name in names}
    for address, value in options.items():
        if address.startswith(prefix):
            chosen[address.removeprefix(prefix)] = value
    for field in msgspec.structs.fields(kind):
        if field.required and field.name not in chosen:
            raise InputError(
                f"{prefix}{field.name}: {kind.__struct_config__.tag!r} needs it, but the "
                "declarations of the dead zone do not contain it"
            )
    return kind(**chosen)


def _options_from_prior(part: str, names: set[str], prior: PriorKnowledge) -> Options:
    """Return the prior information, by the names of the options."""
    if part == "compensator":
        return _actuator_options(prior.actuator)
    p = prior.model.p
    every = msgspec.structs.asdict(prior.declared)
    options = {name: value for name, value in every.items() if value is not None}
    if "correlation_time" not in names:
        options.pop("disturbance", None)  # of another colour there
    guess = prior.widths.mean(axis=1).reshape(2, p).T
    most = prior.widths[:, 1].reshape(2, p).max(axis=0)
    return options | {
        "widths0": guess,
        "width_max": most,
        "reach": prior.reach if part == "controller" else prior.reach[0],
        "scale": prior.reach[0],
    }


def _actuator_options(belief: Belief | None) -> Options:
    """Return the prior information on an actuator, by the names of a compensator's options."""
    if belief is None:
        return {}
    widths = np.stack([belief.drive.right, belief.drive.left])
    options = {"widths0": widths.mean(axis=0)}
    if belief.ranges is not None:
        options["width_max"] = belief.ranges[:, 1].reshape(2, -1).max(axis=0)
    return options
