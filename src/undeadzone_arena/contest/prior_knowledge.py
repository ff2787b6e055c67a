"""Prior information of a method about a scenario, without the truth.

That is the model, the sensor but for its widths, and the declarations of the scenario.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from undeadzone.errors import InputError
from undeadzone.linalg.hold import discretise_noise
from undeadzone.linalg.matrices import Matrices
from undeadzone.linalg.riccati import fast_gain
from undeadzone.nonlinearities.actuator import Belief
from undeadzone.observers.filtering.prior import Assumptions
from undeadzone.observers.filtering.prior import read_width_ranges as ranges
from undeadzone.plants.system import System, fastest_pole, time_scale
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario
from undeadzone.util.arrays import Floats

# In largest widths of the scenario's own sensor: upper end of the default range of its widths.
VAGUE: Final = 3.0
MARGIN: Final = 1.2  # factor on the needs of the reference
# In largest widths: the rms by which a disturbance of which nothing is declared moves z in a
# quarter period.
SWING: Final = 0.5


class PriorKnowledge(NamedTuple):
    """Prior information of a method about a scenario.

    Attributes:
        kind: of the sensor.
        declared: the declared assumptions of the scenario.
        model: sampled if the simulation is.
        widths: declared ranges of all d_r, then all d_l (2p x 2) [z].
        reach: how far |z|, |z'|, ... may go, from the reference and the widths (relative degree)
            [z, z/s, ...].
        loop_rate: geometric mean of the closed loop's poles [1/s].
        actuator: prior information on it (None: there is none).
    """

    kind: str
    declared: Assumptions
    model: System
    widths: Floats
    reach: Floats
    loop_rate: float
    actuator: Belief | None = None

    @property
    def largest_width(self) -> float:
        """Return the largest declared width [z]."""
        return float(self.widths.max())

    @property
    def model_pole(self) -> float:
        """Return the fastest pole of the model [1/s]."""
        return fastest_pole(self.model)

    @property
    def continuous_model(self) -> Matrices:
        """Return the model in continuous time."""
        return self.model.continuous

    @property
    def quarter_time(self) -> float:
        """Return a quarter period of the plant, or 1 s for a chain of integrators [s]."""
        try:
            return time_scale(self.continuous_model)
        except InputError:
            return 1.0

    @property
    def disturbance_correlation(self) -> float:
        """Return the correlation time of the disturbance [s]."""
        declared = self.declared.correlation_time
        return self.quarter_time if declared is None else declared

    @property
    def bias_rms(self) -> float:
        """Return the rms of a constant input disturbance [u]."""
        return 0.0 if self.declared.bias is None else float(np.max(self.declared.bias))

    @property
    def disturbance_rms(self) -> float:
        """Return the rms of the input disturbance [u]."""
        if self.declared.disturbance is not None:
            return float(np.max(self.declared.disturbance))
        A, B, C = self.continuous_model
        reached = float(np.diag(C @ discretise_noise(A, B @ B.T, self.quarter_time)[1] @ C.T).max())
        return SWING * self.largest_width / math.sqrt(2 * self.disturbance_correlation * reached)

    @property
    def white_rms(self) -> float:
        """Return the rms of a disturbance that is new at every sample [u].

        It moves the state as far as bias and gusts do.
        """
        samples = 2 * self.disturbance_correlation / (self.model.Ts or self.disturbance_correlation)
        return math.hypot(self.disturbance_rms, self.bias_rms) * math.sqrt(samples)

    def gain_for_speed(self, speed: float) -> Floats:
        """Return L (n x p) [1/s] for poles of A - L C near -speed [1/s]."""
        return fast_gain(self.model.linear, speed, self.model.Ts) / (self.model.Ts or 1.0)


UNITS: Final[Mapping[str, Callable[[PriorKnowledge], float]]] = MappingProxyType(
    {
        "1": lambda s: 1.0,
        "1/s": lambda s: s.model_pole,
        "s": lambda s: 1 / s.model_pole,
        "z": lambda s: s.largest_width,
        "1/s^2": lambda s: s.model_pole**2,
        "z/s": lambda s: s.largest_width * s.model_pole,
        "z/s^n": lambda s: s.largest_width * s.model_pole ** (s.model.n / s.model.p),
        "u": lambda s: math.hypot(s.disturbance_rms, s.bias_rms),
        "white u": lambda s: s.white_rms,
    }
)


class Setting(NamedTuple):
    """Scenario with the prior information on it."""

    scenario: Scenario
    known: PriorKnowledge


def build_settings(scenarios: Mapping[str, Scenario]) -> dict[str, Setting]:
    """Build the setting of each scenario, by title.

    Raises InputError with the title.
    """
    found = {}
    for title, scenario in scenarios.items():
        try:
            found[title] = build_setting(scenario)
        except InputError as error:
            raise type(error)(f"{title}: {error}") from None
    return found


def build_setting(scenario: Scenario) -> Setting:
    """Build the setting of a scenario. Raises InputError or a subclass."""
    if scenario.sensor.play is not None:
        raise InputError(
            "sensor.play: the arena has no play ahead of a dead zone, which most of its methods do "
            "not know. Compare two observers by [compare]"
        )
    if getattr(scenario.plant.arm, "gears", None) is not None:
        raise InputError(
            "plant.arm.gears: the arena has no gears with gaps, which its methods do not know. "
            "Compare two observers by [compare]"
        )
    problem = resolve_scenario(scenario)
    assumptions = scenario_assumptions(scenario)
    widths = ranges(assumptions.right, assumptions.left, problem.model.p)
    prior = PriorKnowledge(
        kind=scenario.sensor.kind,
        declared=assumptions,
        model=problem.model,
        widths=widths,
        reach=_reference_reach(problem, float(widths.max())),
        loop_rate=_loop_rate(problem),
        actuator=problem.belief,
    )
    return Setting(scenario, prior)


def scenario_assumptions(scenario: Scenario) -> Assumptions:
    """Return the assumptions that the scenario declares.

    They are those of its observer if it declares nothing. If its observer has none, they are that
    widths lie between 0 and VAGUE times the largest.
    """
    if scenario.declared is not None:
        return scenario.declared
    observer = scenario.observer
    sensor = scenario.sensor
    every = {name: getattr(observer, name, None) for name in Assumptions.__struct_fields__}
    assumptions = {name: value for name, value in every.items() if value is not None}
    if "right" in assumptions:
        return Assumptions(**assumptions)
    most = getattr(observer, "width_max", None)
    if most is None:
        limit = VAGUE * max(np.max(sensor.right), np.max(sensor.left))
    else:
        limit = np.max(most)
    return Assumptions(right=np.array([0.0, float(limit)]))


def _reference_reach(problem: Problem, width: float) -> Floats:
    """Return MARGIN times the largest |r|, |r'|, ... of the tracked outputs, z with a width
    more.

    They are as many as one output has derivatives that no input moves.
    """
    flow = problem.flow.linear
    t = np.arange(problem.steps + 1) * problem.scenario.simulation.step
    order = 1
    row = flow.C
    while order < problem.model.n and np.allclose(row @ flow.B, 0.0):
        order = order + 1
        row = row @ flow.A
    largest = np.array([np.abs(problem.reference.output_at(t, k)).max() for k in range(order)])
    return MARGIN * largest + width * (np.arange(order) == 0)


def _loop_rate(problem: Problem) -> float:
    """Return the geometric mean of the poles of A - B K [1/s].

    It is ten times the plant's fastest if the controller has no K.
    """
    K = problem.controller.K
    model = problem.model
    if K is None:
        return 10 * fastest_pole(model)
    poles = np.linalg.eigvals(model.linear.A - model.linear.B @ K)
    if model.Ts is None:
        rates = np.abs(poles)
    else:
        rates = np.abs(np.log(poles.astype(complex))) / model.Ts
    return float(np.exp(np.log(np.maximum(rates, 1e-9)).mean()))
