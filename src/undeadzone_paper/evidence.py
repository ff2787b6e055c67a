"""Runs for the verdicts on the paper's claims.

They are the example as printed, repaired, both off their nominal conditions, and with the paper's
further recommendations: a tanh term, a filter, identification.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any, Final, NamedTuple, cast

import msgspec
import numpy as np

from undeadzone.compensators import ZoneInverse
from undeadzone.controllers import StateFeedback
from undeadzone.controllers.state_feedback import Robust
from undeadzone.nonlinearities.actuator import Actuator, ActuatorModel
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Kalman
from undeadzone.observers.certified import Certified
from undeadzone.observers.luenberger import Luenberger
from undeadzone.plants.options import linear_matrices
from undeadzone.results.run import Run
from undeadzone.scenario.schema import Model, Scenario, Simulation
from undeadzone.signals.exosystem import Sine
from undeadzone.simulation.simulate import simulate
from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.pipeline import identify
from undeadzone_identify.results.result import IdentifiedOutputs
from undeadzone_paper.arm import HALF_GAP, ArmRuns, run_arm
from undeadzone_paper.example import (
    ALPHA,
    AMPLITUDES,
    DURATION,
    L_POLES,
    L_REPAIRED,
    OMEGA,
    STARTED,
    D,
    example_as_printed,
    example_as_repaired,
    example_reference,
)
from undeadzone_paper.measures import with_printed_V
from undeadzone_paper.theorem import (
    AS_PRINTED,
    ESTIMATED,
    GIVEN,
    READINGS_OF_THEOREM,
    TheoremOutcome,
    TheoremVariant,
    example_of_theorem,
    run_theorem,
)

NOISE: Final = 0.02  # rms on y
DISTURBANCE: Final = 1.0  # amplitude at the input, 0.3 Hz
MISMATCH: Final = 0.1  # relative error of the model's stiffness, damping and input gain
SLOPE: Final = 2.5  # m of a sensor that is not normalised
UNAWARE: Final = 0.2  # d^(0) of an observer that does not know d
FIXED_WIDTH: Final = 0.8  # widths of one that never learns them
LOPSIDED: Final = (1.0, 0.5)  # d_r, d_l of a zone that is not symmetric
LESSER: Final = (0.5, 1.0, 1.2)  # amplitudes of a reference at and about the zone's edges
DIRECTIONS: Final = (0.0, 0.5, 1.0, 1.5)  # of starts in the plane of x1 and x2 [pi rad]
RADII: Final = (0.1, 10.0, 1000.0)  # of these starts
SAMPLED: Final = Simulation(time="sampled", step=1e-2)
CONDITIONS: Final[dict[str, Any]] = {
    "noise": NOISE,
    "disturbance": DISTURBANCE,
    "mismatch": MISMATCH,
    "slope": SLOPE,
    "log": SAMPLED.duration,
    "starts": len(DIRECTIONS) * len(RADII),
    "farthest": RADII[-1],
    "least_alpha": 0.01,
    "most_alpha": 1000.0,
    "mismatched": 1 - FIXED_WIDTH,
    "amplitudes": ", ".join(f"{amplitude:g}" for amplitude in (*LESSER, *AMPLITUDES)),
    "half": HALF_GAP,
    "readings": READINGS_OF_THEOREM,
}
"""What the runs are made with, by the names that `claims.toml` uses."""

RESTING: Final = "from rest"
BEGUN: Final = f"from x1 = {STARTED:g}"
SIGNED: Final = f"{BEGUN} with d_l < 0"


class RunPair(NamedTuple):
    """Runs under the same conditions, as printed (started at x1 = 5, d_l > 0) and repaired."""

    printed: tuple[Run, ...]
    repaired: tuple[Run, ...]


class Evidence(NamedTuple):
    """Runs by purpose. V of runs as printed is (30).

    Attributes:
        printed: by their start (r = 5 sin and 2 sin)
        repaired: r = 5 sin and 2 sin
        sampled: repaired, at 100 Hz
        noisy: with noise on y
        mismatched: with wrong models
        disturbed: with a disturbance at the input
        scaled: repaired, with slope m = 2.5
        unaware: as printed, from rest and from x1 = 5, with d^(0) = 0.2
        aware: repaired, with d^(0) = d (in the second z never leaves the zone)
        silent: repaired, d^(0) is wrong and z never leaves the zone
        far: from near and far starts
        blind: Luenberger's observer with the same L takes y for z
        slow: the repaired observer with the paper's poles, L = (12, 15), for 100 s
        fixed_widths: the repaired observer with widths fixed 20 % off: without a tanh term, and
            with one
        filtered: `kalman` with noise on y, and with a disturbance at the input
        logged: repaired, at 100 Hz, noise on y, input gain of the model wrong
        identified: the widths that `identify` finds in the log of that run
        lesser: repaired, by the amplitude of the reference, small ones
        lopsided: with d_r = 1, d_l = 0.5
        still: repaired, with r = 0
        at_input, at_output: `kalman` with noise on y, and an unknown zone at the input, the output
        mismatch: with widths fixed at d, and 20 % off, as printed from x1 = 5 and repaired
        theorem: the outcomes of every reading of Theorem 4.1
        law: the run of Theorem 4.1 from x1 = 5, d - d^ given, and estimated
        arm: errors of a one-link arm behind gears
    """

    printed: dict[str, tuple[Run, ...]]
    repaired: tuple[Run, ...]
    sampled: Run
    noisy: RunPair
    mismatched: RunPair
    disturbed: RunPair
    scaled: Run
    unaware: dict[str, Run]
    aware: tuple[Run, ...]
    silent: Run
    far: RunPair
    blind: Run
    slow: Run
    fixed_widths: tuple[Run, Run]
    filtered: tuple[Run, Run]
    logged: Run
    identified: tuple[Interval, Interval]
    lesser: dict[float, Run]
    lopsided: RunPair
    still: Run
    at_input: Run
    at_output: Run
    mismatch: RunPair
    theorem: list[TheoremOutcome]
    law: tuple[Run, Run]
    arm: ArmRuns


class Runner(NamedTuple):
    """Runner of variations of the example. `progress` is called at every step."""

    progress: Callable[[int], None] | None

    def simulate_changed(self, scenario: Scenario, check_step: bool = False, **changes: Any) -> Run:
        """Simulate a scenario with changes."""
        changed = msgspec.structs.replace(scenario, **changes)
        return simulate(changed, check_step=check_step, progress=self.progress)

    def simulate_pair(self, *variations: dict[str, Any]) -> RunPair:
        """Simulate the example under the same conditions, as printed and repaired."""
        begun = example_as_printed(5.0, x1=STARTED)
        nominal = example_as_repaired(5.0)
        return RunPair(
            tuple(self.simulate_changed(begun, **variation) for variation in variations),
            tuple(self.simulate_changed(nominal, **variation) for variation in variations),
        )


def gather_evidence(progress: Callable[[int], None] | None) -> Evidence:
    """Run all cases. Only nominal runs are repeated with half the step.

    Args:
        progress: called with the number of steps just done
    """
    runner = Runner(progress)
    nominal = example_as_repaired(5.0)
    noisy = Sensor(right=D, left=D, noise=NOISE)
    gust = Sine(amplitude=DISTURBANCE, frequency=0.3)
    within = example_reference(0.5)  # z never leaves the zone
    aware = _change_observer(nominal, widths0=[D, D])
    paper_poles = Certified(L=L_POLES, gamma=2.0, widths0=[0.2, 0.2], width_max=3.0)
    logged = runner.simulate_changed(
        nominal, sensor=noisy, simulation=SAMPLED, model=_wrong_models()[-1]
    )
    return Evidence(
        printed=_runs_as_printed(runner),
        repaired=tuple(
            runner.simulate_changed(example_as_repaired(each), check_step=True)
            for each in AMPLITUDES
        ),
        sampled=runner.simulate_changed(nominal, simulation=SAMPLED),
        noisy=runner.simulate_pair({"sensor": noisy}),
        mismatched=runner.simulate_pair(*({"model": model} for model in _wrong_models())),
        disturbed=runner.simulate_pair({"disturbance": gust}),
        scaled=runner.simulate_changed(nominal, sensor=Sensor(right=D, left=D, slope=SLOPE)),
        unaware=_unaware_runs(runner),
        aware=(
            runner.simulate_changed(nominal, observer=aware),
            runner.simulate_changed(nominal, observer=aware, reference=within),
        ),
        silent=runner.simulate_changed(nominal, reference=within),
        far=_far_runs(runner),
        blind=runner.simulate_changed(nominal, observer=Luenberger(L=L_REPAIRED)),
        slow=runner.simulate_changed(
            nominal, observer=paper_poles, simulation=Simulation(duration=100.0)
        ),
        fixed_widths=_constant_width_runs(runner),
        filtered=(
            runner.simulate_changed(
                nominal, observer=_kalman_options(0.0), simulation=SAMPLED, sensor=noisy
            ),
            runner.simulate_changed(
                nominal, observer=_kalman_options(None), simulation=SAMPLED, disturbance=gust
            ),
        ),
        logged=logged,
        identified=_identify_widths(logged),
        lesser={
            amplitude: runner.simulate_changed(nominal, reference=example_reference(amplitude))
            for amplitude in LESSER
        },
        lopsided=_lopsided_runs(runner),
        still=runner.simulate_changed(nominal, reference=example_reference(0.0)),
        at_input=_run_zone_at_input(runner),
        at_output=runner.simulate_changed(
            nominal, observer=_kalman_options(None), simulation=SAMPLED, sensor=noisy
        ),
        mismatch=_mismatch_runs(runner),
        theorem=run_theorem(progress),
        law=_law_runs(runner),
        arm=run_arm(),
    )


def _runs_as_printed(runner: Runner) -> dict[str, tuple[Run, ...]]:
    """Run the nominal cases as printed, by start."""
    resting = [
        runner.simulate_changed(example_as_printed(amplitude), check_step=True)
        for amplitude in AMPLITUDES
    ]
    outside = [
        runner.simulate_changed(example_as_printed(amplitude, x1=STARTED))
        for amplitude in AMPLITUDES
    ]
    signed = [runner.simulate_changed(example_as_printed(5.0, x1=STARTED, signed_left=True))]
    starts = {RESTING: resting, BEGUN: outside, SIGNED: signed}
    return {start: tuple(with_printed_V(run) for run in runs) for start, runs in starts.items()}


def _change_observer(scenario: Scenario, **changes: Any) -> Any:
    """Return a scenario's observer with changes."""
    return msgspec.structs.replace(cast(Any, scenario.observer), **changes)


def _unaware_runs(runner: Runner) -> dict[str, Run]:
    """Run the example as printed with a wrong d^(0), by start."""
    starts = {RESTING: example_as_printed(5.0), BEGUN: example_as_printed(5.0, x1=STARTED)}
    return {
        start: runner.simulate_changed(
            scenario, observer=_change_observer(scenario, widths0=UNAWARE)
        )
        for start, scenario in starts.items()
    }


def _far_runs(runner: Runner) -> RunPair:
    """Run both versions from starts all around, near and far."""
    starts = []
    for radius, angle in product(RADII, DIRECTIONS):
        place = radius * np.exp(1j * np.pi * angle)
        plant = msgspec.structs.replace(example_as_repaired(5.0).plant, x0=[place.real, place.imag])
        starts.append({"plant": plant, "simulation": Simulation(step=5e-3)})
    return runner.simulate_pair(*starts)


def _constant_width_runs(runner: Runner) -> tuple[Run, Run]:
    """Run the repaired example with wrong fixed widths, without a tanh term and with one."""
    nominal = example_as_repaired(5.0)
    observer = _change_observer(nominal, gamma=1e-9, widths0=[FIXED_WIDTH, FIXED_WIDTH])
    robust = StateFeedback(alpha=ALPHA, robust=Robust(gain=5.0, width=0.05))
    return (
        runner.simulate_changed(nominal, observer=observer),
        runner.simulate_changed(nominal, observer=observer, controller=robust),
    )


def _lopsided_runs(runner: Runner) -> RunPair:
    """Run both versions behind a zone that is not symmetric, with d^(0) = d."""
    sensor = Sensor(right=LOPSIDED[0], left=LOPSIDED[1])
    widths = [list(LOPSIDED)]
    begun = example_as_printed(5.0, x1=STARTED)
    nominal = example_as_repaired(5.0)
    runs = [
        runner.simulate_changed(
            scenario, sensor=sensor, observer=_change_observer(scenario, widths0=widths)
        )
        for scenario in (begun, nominal)
    ]
    return RunPair((runs[0],), (runs[1],))


def _run_zone_at_input(runner: Runner) -> Run:
    """Run `kalman` with an unknown zone at the input, as wide for u as D is for r = 5 sin."""
    A, B, _ = linear_matrices(example_as_printed(1.0).plant)
    force = 5.0 * abs(1j * OMEGA * 1j * OMEGA - A[1, 0] - A[1, 1] * 1j * OMEGA) / B[1, 0]
    width = float(D / 5.0 * force)
    return runner.simulate_changed(
        example_as_repaired(5.0),
        sensor=Sensor(right=0.0, left=0.0, noise=NOISE),
        observer=Kalman(right=[0.0, 1e-6], left=[0.0, 1e-6]),
        actuator=Actuator(right=width, left=width),
        model=Model(actuator=ActuatorModel(right=[0.0, 3 * width], left=[0.0, 3 * width])),
        compensator=ZoneInverse(),
        simulation=SAMPLED,
    )


def _mismatch_runs(runner: Runner) -> RunPair:
    """Run both versions with the widths fixed at d, then 20 % off."""
    begun = example_as_printed(5.0, x1=STARTED)
    nominal = example_as_repaired(5.0)
    printed = []
    repaired = []
    for width in (D, FIXED_WIDTH):
        observer = _change_observer(begun, sigma=0.0, widths0=width)
        printed.append(runner.simulate_changed(begun, observer=observer))
        observer = _change_observer(nominal, gamma=1e-9, widths0=[width, width])
        repaired.append(runner.simulate_changed(nominal, observer=observer))
    return RunPair(tuple(printed), tuple(repaired))


def _law_runs(runner: Runner) -> tuple[Run, Run]:
    """Run Theorem 4.1 from x1 = 5 with d - d^ given, and with it estimated."""
    given, estimated = (
        runner.simulate_changed(
            example_of_theorem(
                TheoremVariant(mismatch, AS_PRINTED, "(39)", "printed", False, -1.0, STARTED, D)
            ),
            simulation=Simulation(duration=DURATION),
        )
        for mismatch in (GIVEN, ESTIMATED)
    )
    return with_printed_V(given), with_printed_V(estimated)


def _kalman_options(disturbance: float | None) -> Kalman:
    """Return the Kalman filter with ranges for the widths and an assumed disturbance."""
    return Kalman(right=[0.1, 3.0], left=[0.1, 3.0], disturbance=disturbance)


def _identify_widths(run: Run) -> tuple[Interval, Interval]:
    """Identify d_r and d_l from u and y of a run, with 95 % intervals [z]."""
    found = identify(t=run.info.step, u=run.u, y=run.y, order=2, place="sensor")
    if isinstance(found, IdentifiedOutputs) or found.right is None or found.left is None:
        raise AssertionError("the log of one output has an answer")
    return found.right, found.left


def _wrong_models() -> list[Model]:
    """Return models with stiffness, damping or input gain wrong by `MISMATCH`."""
    factors = (1 - MISMATCH, 1 + MISMATCH)
    return [
        *(Model(A=[[0.0, 1.0], [-factor, -2.0]]) for factor in factors),
        *(Model(A=[[0.0, 1.0], [-1.0, -2.0 * factor]]) for factor in factors),
        *(Model(B=[[0.0], [factor]]) for factor in factors),
    ]
