"""The contestants of the arena: a line each."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from importlib.resources import as_file, files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple, get_args

import msgspec
import numpy as np

from undeadzone.analysis.certificate.passivity import passive_gain
from undeadzone.arena.prior_knowledge import UNITS, PriorKnowledge, Setting, situation
from undeadzone.arena.tuned_file import load
from undeadzone.controllers import FuzzyFeedback, RBFFeedback, SlidingMode, TaylorFeedback
from undeadzone.errors import InputError
from undeadzone.observers import (  # fmt: skip
    EKF,
    UKF,
    AdaptiveInverse,
    Censored,
    Certified,
    Extended,
    FullState,
    FuzzyResidual,
    HighGain,
    Interval,
    InverseNetwork,
    Kalman,
    Luenberger,
    MovingHorizon,
    ObserverOptions,
    Oracle,
    ParticleFilter,
    Printed,
    RBFResidual,
    RobustGradient,
    SuperTwisting,
    TaylorResidual,
    WalcottZak,
)
from undeadzone.scenario.schema import Scenario

Options = dict[str, Any]
Numbers = Mapping[str, Mapping[str, float]]  # of the knobs, by method and address
NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


class Knob(NamedTuple):
    """A number that is tuned, on a logarithmic scale: its bounds, and the unit of the scenario (`situation.UNITS`) that it is counted in."""

    low: float
    high: float
    unit: str = "1"


class Method(NamedTuple):
    """A contestant: the options of its observer and, where it has its own, its controller.

    knobs: by address, `observer.speed`; fixed: options that are not what they are by default; told(situation, knobs): more
    of them. continuous: it exists in continuous time alone. reference: a line to compare with, no contestant.
    """

    observer: Any
    knobs: Mapping[str, Knob] = NOTHING
    fixed: Mapping[str, Any] = NOTHING
    told: Callable[[PriorKnowledge, Mapping[str, float]], Options] | None = None
    controller: Any = None
    continuous: bool = False
    reference: bool = False


def _by_speed(s: PriorKnowledge, k: Mapping[str, float]) -> Options:
    return {"observer.L": s.gain(k["speed"])}


def _passive(s: PriorKnowledge, k: Mapping[str, float]) -> Options:
    """Any multiple of this gain is certified; there is one for stable plants only."""
    return {"observer.L": k["gain"] * passive_gain(s.model.linear, s.model.Ts)}


def _naive(s: PriorKnowledge, k: Mapping[str, float]) -> Options:
    return {"observer.L": s.gain(NAIVE * s.loop_rate)}


def _deaf(s: PriorKnowledge, k: Mapping[str, float]) -> Options:
    return {"observer.L": np.zeros((s.model.n, s.model.p))}


def _readable(s: PriorKnowledge, k: Mapping[str, float]) -> Options:
    """A jump sensor leaves no width to adapt."""
    return {"observer.gamma": 0.0} if s.kind == "jump" else {}


def _bounded(s: PriorKnowledge, k: Mapping[str, float]) -> Options:
    return {"observer.disturbance": SURELY * math.hypot(s.disturbance_rms, s.bias)}


NAIVE: Final = 2.0  # poles of the naive observer, in those of the closed loop
SURELY: Final = 3.0  # bound of a disturbance, in its rms
RATE, GAIN = Knob(2.0, 100.0, "1/s"), Knob(0.3, 300.0, "1/s")
NOISE, SHAKE, DRIFT = Knob(1e-3, 0.3, "z"), Knob(0.03, 10.0, "white u"), Knob(1e-4, 0.1, "z")
CLAIMS = {"observer.noise": NOISE, "observer.disturbance": SHAKE, "observer.drift": DRIFT}
BLURRED = CLAIMS | {"observer.noise": Knob(0.01, 1.0, "z"), "observer.drift": Knob(0.01, 1.0, "z")}
COLOURED = {
    "observer.disturbance": Knob(0.1, 10.0, "u"),
    "observer.drift": DRIFT,
    "observer.tolerance": Knob(0.01, 0.2),
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

METHODS: Final[Mapping[str, Method]] = MappingProxyType({
    "full_state": Method(FullState, reference=True),
    "oracle": Method(Oracle, {"speed": Knob(0.1, 100.0, "1/s")}, told=_by_speed, reference=True),
    "open_loop": Method(Luenberger, told=_deaf, reference=True),
    "luenberger": Method(Luenberger, told=_naive, reference=True),
    "printed": Method(Printed, {"speed": RATE, "observer.sigma": Knob(1e-3, 10.0)}, told=_by_speed, continuous=True),
    "printed_fed": Method(Printed, {"speed": RATE, "observer.sigma": Knob(1e-3, 10.0)}, {"observer.feed_input": True}, _by_speed, continuous=True),
    "certified": Method(Certified, {"gain": Knob(0.1, 1e4), "observer.gamma": GAIN}, told=_passive),
    "kalman": Method(Kalman, CLAIMS),
    "censored": Method(Censored, COLOURED),
    "extended": Method(Extended, {"observer.disturbance": Knob(0.1, 10.0, "u"), "observer.drift": DRIFT}),
    "ekf": Method(EKF, CLAIMS),
    "ekf_measured": Method(EKF, CLAIMS, {"observer.mode": "measured", "observer.pseudo": False}),
    "ukf": Method(UKF, BLURRED | {"observer.disturbance": Knob(0.1, 100.0, "white u"), "observer.drift": Knob(3e-3, 1.0, "z")}),
    "particle_filter": Method(ParticleFilter, BLURRED),
    "moving_horizon": Method(MovingHorizon, CLAIMS),
    "interval": Method(Interval, {"observer.speed": Knob(0.1, 30.0, "1/s")}, told=_bounded),
    "high_gain": Method(HighGain, {"observer.epsilon": Knob(0.01, 1.0, "s"), "observer.gamma": GAIN}, told=_readable),
    "walcott_zak": Method(WalcottZak, SLIDING, told=_readable),
    "super_twisting": Method(SuperTwisting, TWISTING, told=_readable),
    "sliding_mode": Method(WalcottZak, SLIDING | {"controller.gain": Knob(0.1, 30.0, "u")}, told=_readable, controller=SlidingMode),
    "robust_gradient": Method(RobustGradient, {"observer.speed": RATE, "observer.gamma": Knob(0.03, 30.0, "1/s"), "observer.rho": Knob(1e-5, 0.1, "z")}),
    "adaptive_inverse": Method(AdaptiveInverse, LEARNING),
    "adaptive_inverse_ls": Method(AdaptiveInverse, LEARNING | {"observer.forgetting": Knob(0.003, 30.0)}, {"observer.law": "least_squares"}),
    "adaptive_inverse_literal": Method(AdaptiveInverse, LEARNING, {"observer.silent": "zero"}),
    "inverse_network": Method(InverseNetwork, LEARNING),
    "fuzzy_residual": Method(FuzzyResidual, LEARNING),
    "rbf_residual": Method(RBFResidual, LEARNING),
    "taylor_residual": Method(TaylorResidual, LEARNING),
    "fuzzy_feedback": Method(AdaptiveInverse, LEARNING | FEEDBACK, controller=FuzzyFeedback),
    "rbf_feedback": Method(AdaptiveInverse, LEARNING | FEEDBACK, controller=RBFFeedback),
    "taylor_feedback": Method(AdaptiveInverse, LEARNING | FEEDBACK, controller=TaylorFeedback),
    "fuzzy_feedback_blind": Method(Luenberger, FEEDBACK, told=_naive, controller=FuzzyFeedback),
    "rbf_feedback_blind": Method(Luenberger, FEEDBACK, told=_naive, controller=RBFFeedback),
    "taylor_feedback_blind": Method(Luenberger, FEEDBACK, told=_naive, controller=TaylorFeedback),
})  # fmt: skip


def catalogue() -> dict[str, Method]:
    """Every contestant by name: METHODS, and each observer that has no line there with the options that it has by default."""
    used = {method.observer for method in METHODS.values()}
    return {
        **METHODS,
        **{
            str(each.__struct_config__.tag): Method(each)
            for each in get_args(ObserverOptions)
            if each not in used
        },
    }


def require(name: str) -> str:
    """The name of a method of the catalogue. Raises InputError."""
    known = catalogue()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1)
        raise InputError(
            f"methods: there is no {name!r}; {f'did you mean {near[0]!r}?' if near else 'there are ' + ', '.join(known)}"
        )
    return name


def numbers(path: Path | None = None) -> Numbers:
    """Of the knobs, by method, as `undeadzone arena --tune` found them: in a file of one's own, or those that come with the package. Raises FileError."""
    if path is None:
        with as_file(files("undeadzone.arena") / "tuned.toml") as own:
            return numbers(own)
    return {name: entry.knobs for name, entry in load(path).methods.items()}


def middle(method: Method) -> dict[str, float]:
    """Every knob in the middle of its range: what tuning starts from."""
    return {address: math.sqrt(knob.low * knob.high) for address, knob in method.knobs.items()}


def entered(method: Method, ground: Setting, numbers: Mapping[str, float] = NOTHING) -> Scenario:
    """The scenario with a method in the place of its observer, and of its controller if it has its own. Raises InputError and its kinds."""
    if method.continuous and ground.scenario.simulation.time == "sampled":
        simulation = msgspec.structs.replace(ground.scenario.simulation, time="continuous")
        ground = situation(msgspec.structs.replace(ground.scenario, simulation=simulation))
    scenario, known = ground
    values = middle(method) | {
        address: value for address, value in numbers.items() if address in method.knobs
    }
    knobs = {
        address: value * UNITS[method.knobs[address].unit](known)
        for address, value in values.items()
    }
    given = {**knobs, **method.fixed, **(method.told(known, knobs) if method.told else NOTHING)}
    parts = {"observer": method.observer} | (
        {"controller": method.controller} if method.controller else {}
    )
    return msgspec.structs.replace(
        scenario, **{part: _options(kind, part, known, given) for part, kind in parts.items()}
    )


def _options(kind: Any, part: str, s: PriorKnowledge, given: Mapping[str, Any]) -> Any:
    """The options of a part: what is declared, by the names that they have for it, then what is given by address."""
    names = {field.name for field in msgspec.structs.fields(kind)}
    own = {
        address.removeprefix(f"{part}."): value
        for address, value in given.items()
        if address.startswith(f"{part}.")
    }
    return kind(
        **{name: value for name, value in _declared(part, names, s).items() if name in names} | own
    )


def _declared(part: str, names: set[str], s: PriorKnowledge) -> Options:
    p = s.model.p
    claims = {
        name: value
        for name, value in msgspec.structs.asdict(s.declared).items()
        if value is not None
    }
    if "correlation_time" not in names:
        claims.pop("disturbance", None)  # of another colour there
    guess, most = s.widths.mean(axis=1).reshape(2, p).T, s.widths[:, 1].reshape(2, p).max(axis=0)
    return claims | {
        "widths0": guess,
        "width_max": most,
        "reach": s.reach if part == "controller" else s.reach[0],
        "scale": s.reach[0],
    }
