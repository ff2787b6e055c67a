"""Contestants of the arena, a line each."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import certify, passive_gain
from undeadzone.compensators import NoInverse
from undeadzone.errors import InputError
from undeadzone.observers import (
    Censored,
    Certified,
    Extended,
    FullState,
    HighGain,
    Kalman,
    Luenberger,
    Oracle,
)
from undeadzone.registry import OBSERVERS
from undeadzone.scenario.schema import Scenario
from undeadzone.util.text import suggest_name
from undeadzone_arena.compensators.adaptive_inverse import AdaptiveZoneInverse
from undeadzone_arena.contest.prior_knowledge import UNITS, PriorKnowledge
from undeadzone_arena.controllers.fuzzy_feedback import FuzzyFeedback
from undeadzone_arena.controllers.rbf_feedback import RBFFeedback
from undeadzone_arena.controllers.robust_adaptive import RobustAdaptive
from undeadzone_arena.controllers.sliding_mode import SlidingMode
from undeadzone_arena.controllers.taylor_feedback import TaylorFeedback
from undeadzone_arena.observers.adaptive_inverse import AdaptiveInverse
from undeadzone_arena.observers.ekf import EKF
from undeadzone_arena.observers.fuzzy_residual import FuzzyResidual
from undeadzone_arena.observers.interval import Interval
from undeadzone_arena.observers.inverse_network import InverseNetwork
from undeadzone_arena.observers.moving_horizon import MovingHorizon
from undeadzone_arena.observers.particle import ParticleFilter
from undeadzone_arena.observers.rbf_residual import RBFResidual
from undeadzone_arena.observers.robust_gradient import RobustGradient
from undeadzone_arena.observers.super_twisting import SuperTwisting
from undeadzone_arena.observers.taylor_residual import TaylorResidual
from undeadzone_arena.observers.tobit import Tobit
from undeadzone_arena.observers.ukf import UKF
from undeadzone_arena.observers.walcott_zak import WalcottZak
from undeadzone_paper.observer import Printed

Options = dict[str, Any]
Knobs = Mapping[str, float]  # numbers of one method's knobs, by address
Numbers = Mapping[str, Knobs]  # by method
NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


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
    gamma = np.full(prior.model.p, knobs["observer.gamma"] * UNITS[GAIN.unit](prior))
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

RATE = Knob(2.0, 100.0, "1/s")
GAIN = Knob(0.3, 300.0, "1/s")
NOISE = Knob(1e-3, 0.3, "z")
SHAKE = Knob(0.03, 10.0, "white u")
DRIFT = Knob(1e-4, 0.1, "z")
ASSUMPTIONS = {"observer.noise": NOISE, "observer.disturbance": SHAKE, "observer.drift": DRIFT}
BLURRED = ASSUMPTIONS | {
    "observer.noise": Knob(0.01, 1.0, "z"),
    "observer.drift": Knob(0.01, 1.0, "z"),
}
LEARNING = {"observer.speed": Knob(1.0, 100.0, "1/s"), "observer.gain": Knob(0.3, 3000.0, "1/s")}
SLIDING = {
    "observer.speed": RATE,
    "observer.rho": Knob(0.01, 30.0, "z/s"),
    "observer.boundary": Knob(0.03, 3.0, "z"),
    "observer.gamma": GAIN,
}
TWISTING = {
    "observer.lipschitz": Knob(0.1, 1000.0, "z/s^n"),
    "observer.speed": RATE,
    "observer.gamma": GAIN,
}
FEEDBACK = {
    "controller.speed": Knob(5.0, 100.0, "1/s"),
    "controller.bandwidth": Knob(1.0, 30.0, "1/s"),
    "controller.gain": Knob(0.1, 1000.0, "1/s^2"),
}

ROBUST = {
    "controller.rate": Knob(1.0, 30.0, "1/s"),
    "controller.layer": Knob(0.01, 1.0, "s"),
    "controller.learning": Knob(0.1, 1000.0, "1/s^2"),
}

METHODS: Final[Mapping[str, Method]] = MappingProxyType(
    {
        "informed": Method(FullState, reference=True, informed=True),
        "full_state": Method(FullState, reference=True),
        "oracle": Method(
            Oracle, {"speed": Knob(0.1, 100.0, "1/s")}, derived=_speed_options, reference=True
        ),
        "open_loop": Method(Luenberger, derived=_open_loop_options, reference=True),
        "luenberger": Method(Luenberger, derived=_naive_options, reference=True),
        "printed": Method(
            Printed,
            {"speed": RATE, "observer.sigma": Knob(1e-3, 10.0)},
            derived=_speed_options,
            continuous=True,
        ),
        "printed_fed": Method(
            Printed,
            {"speed": RATE, "observer.sigma": Knob(1e-3, 10.0)},
            {"observer.feed_input": True},
            derived=_speed_options,
            continuous=True,
        ),
        "certified": Method(
            Certified, {"gain": Knob(0.1, 1e4), "observer.gamma": GAIN}, derived=_passivity_options
        ),
        "kalman": Method(Kalman, ASSUMPTIONS),
        "censored": Method(Censored),
        "extended": Method(
            Extended, {"observer.disturbance": Knob(0.1, 10.0, "u"), "observer.drift": DRIFT}
        ),
        "ekf": Method(EKF, ASSUMPTIONS),
        "ekf_measured": Method(
            EKF, ASSUMPTIONS, {"observer.mode": "measured", "observer.pseudo": False}
        ),
        "tobit": Method(Tobit, ASSUMPTIONS),
        "ukf": Method(
            UKF,
            BLURRED
            | {
                "observer.disturbance": Knob(0.1, 100.0, "white u"),
                "observer.drift": Knob(3e-3, 1.0, "z"),
            },
        ),
        "particle_filter": Method(ParticleFilter, BLURRED),
        "moving_horizon": Method(MovingHorizon, ASSUMPTIONS),
        "interval": Method(
            Interval, {"observer.speed": Knob(0.1, 30.0, "1/s")}, derived=_disturbance_options
        ),
        "high_gain": Method(
            HighGain,
            {"observer.epsilon": Knob(0.01, 1.0, "s"), "observer.gamma": GAIN},
            derived=_jump_options,
        ),
        "walcott_zak": Method(WalcottZak, SLIDING, derived=_jump_options),
        "super_twisting": Method(SuperTwisting, TWISTING, derived=_jump_options),
        "sliding_mode": Method(
            WalcottZak,
            SLIDING | {"controller.gain": Knob(0.1, 30.0, "u")},
            derived=_jump_options,
            controller=SlidingMode,
        ),
        "robust_gradient": Method(
            RobustGradient,
            {
                "observer.speed": RATE,
                "observer.gamma": Knob(0.03, 30.0, "1/s"),
                "observer.rho": Knob(1e-5, 0.1, "z"),
            },
        ),
        "adaptive_inverse": Method(AdaptiveInverse, LEARNING),
        "adaptive_inverse_ls": Method(
            AdaptiveInverse,
            LEARNING | {"observer.forgetting": Knob(0.003, 30.0)},
            {"observer.law": "least_squares"},
        ),
        "adaptive_inverse_literal": Method(AdaptiveInverse, LEARNING, {"observer.silent": "zero"}),
        "inverse_network": Method(InverseNetwork, LEARNING),
        "fuzzy_residual": Method(FuzzyResidual, LEARNING),
        "rbf_residual": Method(RBFResidual, LEARNING),
        "taylor_residual": Method(TaylorResidual, LEARNING),
        "fuzzy_feedback": Method(AdaptiveInverse, LEARNING | FEEDBACK, controller=FuzzyFeedback),
        "rbf_feedback": Method(AdaptiveInverse, LEARNING | FEEDBACK, controller=RBFFeedback),
        "taylor_feedback": Method(AdaptiveInverse, LEARNING | FEEDBACK, controller=TaylorFeedback),
        "fuzzy_feedback_blind": Method(
            Luenberger, FEEDBACK, derived=_naive_options, controller=FuzzyFeedback
        ),
        "rbf_feedback_blind": Method(
            Luenberger, FEEDBACK, derived=_naive_options, controller=RBFFeedback
        ),
        "taylor_feedback_blind": Method(
            Luenberger, FEEDBACK, derived=_naive_options, controller=TaylorFeedback
        ),
        "both_adaptive_inverses": Method(
            AdaptiveInverse,
            LEARNING | {"compensator.gain": Knob(1.0, 1000.0, "1/s")},
            compensator=AdaptiveZoneInverse,
        ),
        "actuator_inverse_blind": Method(
            Luenberger,
            {"compensator.gain": Knob(1.0, 1000.0, "1/s")},
            derived=_naive_options,
            compensator=AdaptiveZoneInverse,
        ),
        "robust_adaptive": Method(
            Kalman, ASSUMPTIONS | ROBUST, controller=RobustAdaptive, compensator=NoInverse
        ),
        "robust_adaptive_blind": Method(
            Luenberger,
            ROBUST,
            derived=_naive_options,
            controller=RobustAdaptive,
            compensator=NoInverse,
        ),
    }
)


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
