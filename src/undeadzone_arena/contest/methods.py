"""Contestants of the arena, a table of `methods.toml` each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify, passive_gain
from undeadzone.errors import InputError
from undeadzone.registry import COMPENSATORS, CONTROLLERS, OBSERVERS
from undeadzone.scenario.schema import Scenario
from undeadzone.util.files import read_table
from undeadzone.util.text import suggest_name
from undeadzone_arena.contest.prior_knowledge import UNITS, PriorKnowledge

Options = dict[str, Any]
Knobs = Mapping[str, float]  # numbers of one method's knobs, by address
Numbers = Mapping[str, Knobs]  # by method
NOTHING: Final[Mapping[str, Any]] = {}


class Knob(NamedTuple):
    """Number that is tuned on a logarithmic scale.

    Attributes:
        low, high: its bounds.
        unit: of the scenario (`prior_knowledge.UNITS`), in which it is counted.
    """

    low: float
    high: float
    unit: str = "1"


class Method(NamedTuple):
    """Contestant: the options of its observer and, if it has its own, its controller.

    Attributes:
        observer: options of the observer.
        knobs: the tuned options, by address, `observer.speed`.
        fixed: options that differ from their defaults, by address.
        derived: derived(prior, knobs) is more options, from the prior information on the scenario.
        controller: options of its own controller (None: the scenario's).
        compensator: options of its own compensator, which needs an actuator (None: the scenario's).
        continuous: whether it exists in continuous time alone.
        reference: whether it is a line to compare with, no contestant.
        informed: whether it knows the disturbance and the true plant, too.
    """

    observer: Any
    knobs: Mapping[str, Knob] = NOTHING
    fixed: Mapping[str, Any] = NOTHING
    derived: Callable[[PriorKnowledge, Knobs], Options] | None = None
    controller: Any = None
    compensator: Any = None
    continuous: bool = False
    reference: bool = False
    informed: bool = False


def _speed_options(prior: PriorKnowledge, knobs: Knobs) -> Options:
    """Return the option L for poles of the knob's speed."""
    return {"observer.L": prior.gain_for_speed(knobs["speed"])}


def _passivity_options(prior: PriorKnowledge, knobs: Knobs) -> Options:
    """Return the option L in a certified direction, as strong as the certificate allows.

    For stable plants only.
    """
    linear = prior.model.linear
    Ts = prior.model.Ts
    direction = passive_gain(linear, Ts)
    gamma = np.full(prior.model.p, knobs["observer.gamma"] * UNITS["1/s"](prior))
    gain = knobs["gain"]
    while gain > 1 and not certify(linear, gain * direction, gamma, Ts).certified:
        gain /= 2  # sampled, a large multiple is not certified; in continuous time every one is
    return {"observer.L": gain * direction}


def _naive_options(prior: PriorKnowledge, knobs: Knobs) -> Options:
    """Return the option L for poles somewhat faster than those of the closed loop."""
    return {"observer.L": prior.gain_for_speed(NAIVE * prior.loop_rate)}


def _open_loop_options(prior: PriorKnowledge, knobs: Knobs) -> Options:
    """Return the option L = 0: no correction."""
    return {"observer.L": np.zeros((prior.model.n, prior.model.p))}


def _jump_options(prior: PriorKnowledge, knobs: Knobs) -> Options:
    """Return the option gamma = 0 for a jump sensor, which leaves no width to adapt."""
    return {"observer.gamma": 0.0} if prior.kind == "jump" else {}


def _disturbance_options(prior: PriorKnowledge, knobs: Knobs) -> Options:
    """Return the option of the bound of the disturbance."""
    return {"observer.disturbance": SURELY * math.hypot(prior.disturbance_rms, prior.bias_rms)}


RECOMMENDED: Final = ("auto", "censored", "kalman", "certified")
NAIVE: Final = 2.0  # poles of the naive observer, in those of the closed loop
SURELY: Final = 3.0  # bound of a disturbance, in its rms

DERIVED: Final[Mapping[str, Callable[[PriorKnowledge, Knobs], Options]]] = {
    "speed": _speed_options,
    "passivity": _passivity_options,
    "naive": _naive_options,
    "open_loop": _open_loop_options,
    "jump": _jump_options,
    "disturbance": _disturbance_options,
}
PARTS: Final = {"observer": OBSERVERS, "controller": CONTROLLERS, "compensator": COMPENSATORS}


def _read_methods() -> dict[str, Method]:
    """Read the methods of `methods.toml`, in its order."""
    tables = read_table(__file__)
    groups = tables.pop("knobs")
    methods = {}
    for name, entry in tables.items():
        knobs: dict[str, Any] = {}
        for group in entry.pop("tuned", []):
            knobs |= groups[group]
        knobs |= entry.pop("knobs", {})
        for part in entry.keys() & PARTS:
            entry[part] = PARTS[part].find_options(entry[part])
        if "derived" in entry:
            entry["derived"] = DERIVED[entry["derived"]]
        methods[name] = Method(**entry, knobs=msgspec.convert(knobs, dict[str, Knob]))
    return methods


METHODS: Final = _read_methods()


def method_registry() -> dict[str, Method]:
    """Return all contestants by name.

    Besides METHODS, it has each observer that has no line there, with its default options.
    """
    used = {method.observer for method in METHODS.values()}
    every = dict(METHODS)
    for observer in OBSERVERS.list_options():
        if observer not in used:
            every[str(observer.__struct_config__.tag)] = Method(observer)
    return every


def method_from_options(options: Any) -> Method:
    """Convert a user's options to a method: set options are fixed, the rest is declared."""
    fixed = {}
    for field in msgspec.structs.fields(options):
        value = getattr(options, field.name)
        if field.required or value is not field.default:
            fixed[f"observer.{field.name}"] = value
    return Method(type(options), fixed=fixed)


def methods_for_scenarios(scenarios: Iterable[Scenario]) -> list[str]:
    """List all contestants for scenarios.

    Methods that need an actuator are left out if no scenario has one.
    """
    actuated = any(scenario.actuator is not None for scenario in scenarios)
    every = method_registry().items()
    return [name for name, method in every if actuated or method.compensator is None]


def require_method(name: str) -> str:
    """Return the name of a registered method. Raises InputError."""
    known = method_registry()
    if name in known:
        return name
    raise InputError(f"methods: there is no {name!r}. {suggest_name(name, known, 'There are')}")


def middle_knobs(method: Method) -> dict[str, float]:
    """Return all knobs in the middle of their ranges, where tuning starts."""
    return {address: math.sqrt(knob.low * knob.high) for address, knob in method.knobs.items()}
