"""What a method may know of a scenario: the believed model, the sensor but for its widths, and what is declared; never the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linear.hold import sampled_noise
from undeadzone.linear.matrices import Matrices
from undeadzone.observers.parts.claims import Claims
from undeadzone.observers.parts.gain import fast_gain
from undeadzone.observers.parts.prior import width_ranges as ranges
from undeadzone.plants.system import System
from undeadzone.plants.time_scales import fastest_pole, time_scale
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.support.arrays import Floats

VAGUE: Final = 3.0  # largest width of the scenario's own sensor, in which its widths are taken to lie where nothing is declared
MARGIN: Final = 1.2  # beyond what the reference asks for
SWING: Final = 0.5  # rms, in largest widths, by which a disturbance of which nothing is declared moves z in a quarter period


class PriorKnowledge(NamedTuple):
    """kind: of the sensor; declared; model: sampled if the simulation is; widths: declared ranges of all d_r, then all d_l (2p x 2) [z].

    reach: how far |z|, |z'|, ... may go, from the reference and the widths (relative degree) [z, z/s, ...].
    loop_rate: geometric mean of the closed loop's poles [1/s].
    """

    kind: str
    declared: Claims
    model: System
    widths: Floats
    reach: Floats
    loop_rate: float

    @property
    def width(self) -> float:
        """The largest declared width [z]."""
        return float(self.widths.max())

    @property
    def pole(self) -> float:
        """The fastest pole of the model [1/s]."""
        return fastest_pole(self.model)

    @property
    def flow(self) -> Matrices:
        """The model in continuous time."""
        return self.model.linear if self.model.flow is None else self.model.flow

    @property
    def quarter(self) -> float:
        """A quarter period of the plant; 1 s of one that only integrates [s]."""
        try:
            return time_scale(self.flow)
        except InputError:
            return 1.0

    @property
    def correlation(self) -> float:
        """The correlation time of the disturbance [s]."""
        return (
            self.quarter
            if self.declared.correlation_time is None
            else self.declared.correlation_time
        )

    @property
    def bias(self) -> float:
        """The rms of a constant input disturbance [u]."""
        return 0.0 if self.declared.bias is None else float(np.max(self.declared.bias))

    @property
    def disturbance_rms(self) -> float:
        """The rms of the input disturbance [u]."""
        if self.declared.disturbance is not None:
            return float(np.max(self.declared.disturbance))
        A, B, C = self.flow
        reached = float(np.diag(C @ sampled_noise(A, B @ B.T, self.quarter)[1] @ C.T).max())
        return SWING * self.width / math.sqrt(2 * self.correlation * reached)

    @property
    def white(self) -> float:
        """The rms of a disturbance that is new at every sample and moves the state as far as bias and gusts do [u]."""
        return math.hypot(self.disturbance_rms, self.bias) * math.sqrt(
            2 * self.correlation / (self.model.Ts or self.correlation)
        )

    def gain(self, speed: float) -> Floats:
        """L (n x p) [1/s] for poles of A - L C near -speed [1/s]."""
        return fast_gain(self.model.linear, speed, self.model.Ts) / (self.model.Ts or 1.0)


UNITS: Final[Mapping[str, Callable[[PriorKnowledge], float]]] = MappingProxyType(
    {
        "1": lambda s: 1.0,
        "1/s": lambda s: s.pole,
        "s": lambda s: 1 / s.pole,
        "z": lambda s: s.width,
        "1/s^2": lambda s: s.pole**2,
        "z/s": lambda s: s.width * s.pole,
        "z/s^n": lambda s: s.width * s.pole ** (s.model.n / s.model.p),
        "u": lambda s: math.hypot(s.disturbance_rms, s.bias),
        "white u": lambda s: s.white,
    }
)


class Setting(NamedTuple):
    """A scenario, and what may be known of it."""

    scenario: Scenario
    known: PriorKnowledge


def situation(scenario: Scenario) -> Setting:
    """What is known of a scenario. Raises InputError and its kinds."""
    problem = resolve_scenario(scenario)
    given = declaration(scenario)
    widths = ranges(given.right, given.left, problem.model.p)
    return Setting(
        scenario,
        PriorKnowledge(
            scenario.sensor.kind,
            given,
            problem.model,
            widths,
            _reach(problem, float(widths.max())),
            _loop_rate(problem),
        ),
    )


def declaration(scenario: Scenario) -> Claims:
    """What the scenario declares; else what its observer is told; else that widths lie between 0 and VAGUE times the largest."""
    if scenario.declared is not None:
        return scenario.declared
    observer = scenario.observer
    told = {
        name: value
        for name in Claims.__struct_fields__
        if (value := getattr(observer, name, None)) is not None
    }
    if "right" in told:
        return Claims(**told)
    most = getattr(observer, "width_max", None)
    limit = (
        VAGUE * max(np.max(scenario.sensor.right), np.max(scenario.sensor.left))
        if most is None
        else np.max(most)
    )
    return Claims(right=np.array([0.0, float(limit)]))


def _reach(problem: Problem, width: float) -> Floats:
    """MARGIN times the largest |r|, |r'|, ... over the tracked outputs, as many as one output has derivatives that no input moves; z wider by a width."""
    flow, t = problem.flow.linear, np.arange(problem.steps + 1) * problem.scenario.simulation.step
    order, row = 1, flow.C
    while order < problem.model.n and np.allclose(row @ flow.B, 0.0):
        order, row = order + 1, row @ flow.A
    found = np.array([np.abs(problem.reference.value(t, k)).max() for k in range(order)])
    return MARGIN * found + width * (np.arange(order) == 0)


def _loop_rate(problem: Problem) -> float:
    """Of the poles of A - B K; ten times the plant's fastest where the controller has no K."""
    K = problem.controller.K
    if K is None:
        return 10 * fastest_pole(problem.model)
    poles = np.linalg.eigvals(problem.model.linear.A - problem.model.linear.B @ K)
    rates = (
        np.abs(poles)
        if problem.model.Ts is None
        else np.abs(np.log(poles.astype(complex))) / problem.model.Ts
    )
    return float(np.exp(np.log(np.maximum(rates, 1e-9)).mean()))
