"""What is behind a play follows the reference: how well, at which cost; and what a load does."""

from __future__ import annotations

import msgspec
import numpy as np

from benchmarks.loops.plants.random_loops import Loops, run_loops
from benchmarks.loops.plants.two_masses import GAIN, NOISE, TAU, TS, TURN, Log, two_masses
from benchmarks.loops.play import WORLDS, Options, World, kalman, known, posed
from benchmarks.markdown import head, row
from undeadzone.controllers import StateFeedback
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Kalman, Luenberger
from undeadzone.plants.options import Plant
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Model, Scenario, Simulation
from undeadzone.signals.exosystem import Sine
from undeadzone.simulation.estimate import estimate
from undeadzone.util.arrays import Array

MOTOR, READING = WORLDS["motor"], "encoder 0.3 %"
RATES = (15.0, 30.0, 60.0, 120.0)
FASTER = (2.0, 4.0, 8.0)  # poles of an observer that takes y for z, in those of the loop
OVERRUNS = (0.1, 0.5, 0.9, 1.2, 2.0)  # of logs; a run above 1 is refused
FRICTION = 0.02  # of the load [u]
LOGS = 16


def naive(factor: float) -> Options:
    """Luenberger's observer, which takes y for z."""

    def options(world: World, gaps: tuple[float, float]) -> Luenberger:
        return Luenberger(poles=[-factor * world.poles, -1.1 * factor * world.poles])

    return options


def table(loops: int = 100) -> str:
    """Both tables."""
    return "\n".join([*_following(loops), *_loads()])


def _following(loops: int) -> list[str]:
    """How well what is behind the play follows, and the input that it takes."""
    plain = _run(kalman, None, loops)
    every = {"z follows r, `kalman`": plain}
    by_pole = [_run(naive(factor), None, loops) for factor in FASTER]
    every["y taken for z"] = min(by_pole, key=lambda ran: float(np.median(ran.behind)))
    for rate in RATES:
        every[f"`behind_play = {rate:g}`, `kalman`"] = _run(kalman, rate, loops)
    every["`behind_play = 60`, gaps known"] = _run(known, 60.0, loops)
    names = ("loops", "rms y / m - r", "share of the first row", "largest input")
    lines = ["## Behind a play\n", *head(*names)]
    for name, ran in every.items():
        share = np.median(ran.behind / plain.behind)
        cells = f"{np.median(ran.behind):.3g}", f"{share:.3f}", f"{np.median(ran.peak):.2g}"
        lines.append(row(name, *cells))
    about = (
        f"A motor behind whose gears an encoder of 0.3 % reads: {loops} loops a row, medians over "
        "the last fifth of each. y taken for z: the best of three observers.\n"
    )
    return [*lines, "", about]


def _run(options: Options, rate: float | None, loops: int) -> Loops:
    """The loops of one row."""
    each = [_led(posed(MOTOR, READING, options, False, seed), rate) for seed in range(loops)]
    return run_loops(each, 0.8 * MOTOR.duration)


def _led(problem: Problem, rate: float | None) -> Problem:
    """A problem whose z is led across the gap."""
    return resolve_scenario(msgspec.structs.replace(problem.scenario, behind_play=rate))


def _loads() -> list[str]:
    """The error of the gap of two masses, by what is known of the load's friction."""
    names = ("J a / f", "friction not told", "known", "a range, estimated")
    lines = ["## Friction behind a play\n", *head(*names)]
    for number in OVERRUNS:
        logs = [two_masses(number * FRICTION / TURN, FRICTION, seed) for seed in range(LOGS)]
        cells = []
        for friction in (0.0, FRICTION, [0.0, 5 * FRICTION]):
            error = [gap_error(log, friction) for log in logs]
            cells.append(f"{100 * np.median(error):+.1f}")
        lines.append(row(f"{number:g}", *cells))
    about = (
        f"Error of the gap that `kalman` finds [%], median of {LOGS} gaps: a motor and a load in "
        f"stiff contact, with Coulomb friction, read behind the gap with noise of {NOISE:g}.\n"
    )
    return [*lines, "", about]


def gap_error(log: Log, load_friction: Array) -> float:
    """The relative error of the gap that `kalman` finds in a log of two masses."""
    plant = Plant(A=[[0.0, 1.0], [0.0, -1 / TAU]], B=[[0.0], [GAIN]], C=[[1.0, 0.0]])
    scenario = Scenario(
        plant=plant,
        model=Model(load_friction=load_friction),
        sensor=Sensor(kind="play", right=0.1, left=0.1, noise=NOISE),
        reference=Sine(amplitude=1.0, frequency=0.5),
        observer=Kalman(right=[0.0, 0.2], disturbance=0.05),
        controller=StateFeedback(poles=[-20.0, -21.0]),
        simulation=Simulation(duration=1.0, time="sampled", step=TS),
    )
    found = estimate(scenario, t=log.t, y=log.y, u=log.u)
    return float(found.d_hat[-1].sum() / log.gap - 1)
