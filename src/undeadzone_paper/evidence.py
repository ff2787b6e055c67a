"""The runs on which the paper's claims are judged.

They are the example as printed, repaired, and both off their nominal conditions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import msgspec

from undeadzone.ends.sensor import Sensor
from undeadzone.observers.certified import Certified
from undeadzone.observers.luenberger import Luenberger
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Model, Scenario, Simulation
from undeadzone.signals.exosystem import Sine
from undeadzone.simulation.simulate import simulate
from undeadzone_paper.example import (
    AMPLITUDES,
    L_POLES,
    L_REPAIRED,
    STARTED,
    D,
    printed,
    reference,
    repaired,
)
from undeadzone_paper.measures import with_printed_V

NOISE: Final = 0.02  # rms on y
DISTURBANCE: Final = 1.0  # amplitude at the input, 0.3 Hz
MISMATCH: Final = 0.1  # relative error of the model's stiffness, damping and input gain
SLOPE: Final = 2.5  # m of a sensor that is not normalised

RESTING: Final = "from rest"
BEGUN: Final = f"from x1 = {STARTED:g}"
SIGNED: Final = f"{BEGUN} with d_l < 0"


class Pair(NamedTuple):
    """Runs under the same conditions, as printed (started at x1 = 5, d_l > 0) and repaired."""

    printed: tuple[Run, ...]
    repaired: tuple[Run, ...]


class Evidence(NamedTuple):
    """Runs by what they show; V of those as printed is (30).

    Attributes:
        printed: by how they start; r = 5 sin and 2 sin
        repaired: r = 5 sin and 2 sin
        sampled: repaired, at 100 Hz
        noisy: with noise on y
        mismatched: with wrong models
        disturbed: with a disturbance at the input
        scaled: with slope m = 2.5
        silent: d^(0) is wrong and z never leaves the zone; here as printed starts from rest
        blind: Luenberger's observer with the same L takes y for z
        slow: the repaired observer with the paper's poles, L = (12, 15), for 100 s
    """

    printed: dict[str, tuple[Run, ...]]
    repaired: tuple[Run, ...]
    sampled: Run
    noisy: Pair
    mismatched: Pair
    disturbed: Pair
    scaled: Pair
    silent: Pair
    blind: Run
    slow: Run


def gather(progress: Callable[[int], None] | None = None) -> Evidence:
    """Run them all. Only nominal runs are repeated with half the step.

    Args:
        progress: called with the number of steps just done
    """
    begun, nominal = printed(5.0, x1=STARTED), repaired(5.0)

    def run(scenario: Scenario, check_step: bool = False) -> Run:
        return simulate(scenario, check_step=check_step, progress=progress)

    def change(scenario: Scenario, **changes: Any) -> Run:
        return run(msgspec.structs.replace(scenario, **changes))

    def pair(*variations: dict[str, Any]) -> Pair:
        return Pair(
            tuple(change(begun, **variation) for variation in variations),
            tuple(change(nominal, **variation) for variation in variations),
        )

    def as_printed(check_step: bool, *scenarios: Scenario) -> tuple[Run, ...]:
        return tuple(with_printed_V(run(scenario, check_step)) for scenario in scenarios)

    resting = [printed(amplitude) for amplitude in AMPLITUDES]
    outside = [printed(amplitude, x1=STARTED) for amplitude in AMPLITUDES]
    signed = printed(5.0, x1=STARTED, signed_left=True)
    options: Any = begun.observer
    unaware = msgspec.structs.replace(options, widths0=0.0)
    paper_poles = Certified(L=L_POLES, gamma=2.0, widths0=[0.2, 0.2], width_max=3.0)
    return Evidence(
        printed={
            RESTING: as_printed(True, *resting),
            BEGUN: as_printed(False, *outside),
            SIGNED: as_printed(False, signed),
        },
        repaired=tuple(run(repaired(amplitude), check_step=True) for amplitude in AMPLITUDES),
        sampled=change(nominal, simulation=Simulation(time="sampled", step=1e-2)),
        noisy=pair({"sensor": Sensor(right=D, left=D, noise=NOISE)}),
        mismatched=pair(*({"model": model} for model in _mismatches())),
        disturbed=pair({"disturbance": Sine(amplitude=DISTURBANCE, frequency=0.3)}),
        scaled=pair({"sensor": Sensor(right=D, left=D, slope=SLOPE)}),
        silent=Pair(
            (change(printed(5.0), observer=unaware),),
            (change(nominal, reference=reference(0.5)),),
        ),
        blind=change(nominal, observer=Luenberger(L=L_REPAIRED)),
        slow=change(nominal, observer=paper_poles, simulation=Simulation(duration=100.0)),
    )


def _mismatches() -> list[Model]:
    """Models with stiffness, damping or input gain too small or too large by `MISMATCH`."""
    factors = (1 - MISMATCH, 1 + MISMATCH)
    return [
        *(Model(A=[[0.0, 1.0], [-factor, -2.0]]) for factor in factors),
        *(Model(A=[[0.0, 1.0], [-1.0, -2.0 * factor]]) for factor in factors),
        *(Model(B=[[0.0], [factor]]) for factor in factors),
    ]
