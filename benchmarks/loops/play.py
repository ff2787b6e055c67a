"""Closed loops behind a play: gaps and hidden output, against known gaps and wrong models.

`python -m benchmarks play --plants motor --readings "noise 1 %"` runs a part of the table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.loops.plants.random_loops import Loops, ratio_cells, run_loops, white_censored
from benchmarks.markdown import head, row
from undeadzone.controllers import StateFeedback
from undeadzone.nonlinearities.sensor import Sensor, resolve
from undeadzone.observers import Censored, Certified, Kalman, Luenberger
from undeadzone.plants.options import Plant
from undeadzone.plants.system import plant_pace
from undeadzone.registry import ObserverOptions
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.signals.exosystem import Random, Sine
from undeadzone_arena import AdaptiveInverse

SLIGHT = 1e-6  # half of the range of a gap that is known


class World(NamedTuple):
    """One family of loops z'' = -a0 z - a1 z' + b u.

    Attributes:
        plant: a0, a1, b.
        step: sample time [s].
        reference: amplitude [z] and frequency [Hz].
        poles: rate of the closed loop [1/s].
        gaps: least and largest true gap of a side [z].
        gap_range: range of the gaps that is assumed [z].
        disturbance: white, at the input, rms [u].
        gains: L and gamma of the certified observer; None: no certificate exists.
        duration: of a loop [s].
    """

    plant: tuple[float, float, float]
    step: float
    reference: tuple[float, float]
    poles: float
    gaps: tuple[float, float]
    gap_range: list[float]
    disturbance: float
    gains: tuple[list[float], float] | None
    duration: float


WORLDS = {
    "slow": World(
        (1.0, 2.0, 1.0),
        0.01,
        (5.0, 0.2),
        8.0,
        (0.3, 1.5),
        [0.0, 2.0],
        0.8,
        ([1.0, 1.5], 10.0),
        30.0,
    ),
    "arm": World(
        (30.0, 10.0, 100.0),
        5e-3,
        (1.0, 0.5),
        20.0,
        (0.02, 0.1),
        [0.0, 0.2],
        0.05,
        ([1.0, 1.0], 10.0),
        12.0,
    ),
    "motor": World(
        (0.0, 10.0, 100.0), 5e-3, (1.0, 0.5), 20.0, (0.02, 0.1), [0.0, 0.2], 0.05, None, 12.0
    ),
}
READINGS = {  # noise and quantum, in amplitudes of the reference
    "noise 0.2 %": (0.002, 0.0),
    "noise 1 %": (0.01, 0.0),
    "encoder 0.3 %": (0.0, 0.0031),
    "encoder 3 %": (0.0, 0.03),
}
Widths = tuple[float, ...]  # c_r, c_l; d_r, d_l of a dead zone after the play
Options = Callable[[World, Widths], ObserverOptions]


def kalman(world: World, gaps: Widths) -> Kalman:
    """It knows the range of the gaps."""
    return Kalman(right=world.gap_range, disturbance=world.disturbance)


def known(world: World, gaps: Widths) -> Kalman:
    """It knows the gaps."""
    right, left = ([max(gap - SLIGHT, 0.0), gap + SLIGHT] for gap in gaps)
    return Kalman(right=right, left=left, disturbance=world.disturbance)


def censored(world: World, gaps: Widths) -> Censored:
    """It knows the range of the gaps, and hears what a held reading bounds."""
    return white_censored(world.step, right=world.gap_range, disturbance=world.disturbance)


def ranges_alone(world: World, gaps: Widths) -> Censored:
    """It knows the range of the gaps, and nothing else."""
    return Censored(right=world.gap_range)


def certified(world: World, gaps: Widths) -> Certified:
    """Constant gains with a certificate."""
    assert world.gains is not None
    L, gamma = world.gains
    middle = float(np.mean(world.gap_range))
    return Certified(L=[[gain] for gain in L], gamma=gamma, widths0=middle)


def inverse(world: World, gaps: Widths) -> AdaptiveInverse:
    """The adaptive inverse of Tao and Kokotovic."""
    return AdaptiveInverse(widths0=float(np.mean(world.gap_range)), width_max=world.gap_range[1])


def naive(world: World, gaps: Widths) -> Luenberger:
    """It takes y for z."""
    return Luenberger(poles=[-2 * world.poles, -2.2 * world.poles])


OBSERVERS: dict[str, tuple[Options, bool]] = {
    "gaps known": (known, False),
    "`kalman`": (kalman, False),
    "`censored`": (censored, False),
    "`censored`, ranges alone": (ranges_alone, False),
    "`certified`": (certified, False),
    "`adaptive_inverse`": (inverse, False),
    "`kalman`, taken for a dead zone": (kalman, True),
    "y taken for z": (naive, False),
}


def rms_and_quantum(world: World, reading: tuple[float, float]) -> tuple[float, float]:
    """Noise and quantum [y], of shares of the reference's amplitude."""
    noise, quantum = (world.reference[0] * share for share in reading)
    return noise, quantum


def loop(
    world: World, sensor: Sensor, observer: ObserverOptions, rng: np.random.Generator, seed: int
) -> Scenario:
    """A loop of a family from a random start.

    Args:
        world: the family.
        sensor: its sensor.
        observer: its observer.
        rng: draws the start.
        seed: of noise and disturbance.
    """
    (a0, a1, b), (amplitude, frequency) = world.plant, world.reference
    x0 = [float(amplitude * rng.uniform(-0.3, 0.3)), 0.0]
    return Scenario(
        plant=Plant(A=[[0.0, 1.0], [-a0, -a1]], B=[[0.0], [b]], C=[[1.0, 0.0]], x0=x0),
        sensor=sensor,
        reference=Sine(amplitude=amplitude, frequency=frequency),
        observer=observer,
        controller=StateFeedback(poles=[-world.poles, -1.05 * world.poles]),
        disturbance=Random(rms=world.disturbance, correlation_time=1e-4),
        simulation=Simulation(duration=world.duration, time="sampled", step=world.step, seed=seed),
    )


def posed(world: World, reading: str, options: Options, mistaken: bool, seed: int) -> Problem:
    """One random loop.

    Args:
        world: its family.
        reading: of `READINGS`.
        options: of the observer.
        mistaken: whether the observer takes the play for a dead zone.
        seed: of everything random.
    """
    rng = np.random.default_rng([seed, 18])
    gaps = tuple(rng.uniform(*world.gaps, 2))
    noise, quantum = rms_and_quantum(world, READINGS[reading])
    sensor = Sensor(kind="play", right=gaps[0], left=gaps[1], noise=noise, quantum=quantum)
    scenario = loop(world, sensor, options(world, gaps), rng, seed)
    problem = resolve_scenario(scenario)
    if not mistaken:
        return problem
    plain = msgspec.structs.replace(sensor, kind="deadzone")
    return take_for(problem, world, plain, options(world, gaps))


def take_for(problem: Problem, world: World, sensor: Sensor, options: ObserverOptions) -> Problem:
    """Return a problem whose observer takes its sensor for another one."""
    zone = resolve(sensor, 1, world.step, plant_pace(problem.flow.linear))
    return problem._replace(observer=options.build(problem.model, zone))


def table(
    loops: int = 100, plants: Sequence[str] = (*WORLDS,), readings: Sequence[str] = (*READINGS,)
) -> str:
    """The table, of that many loops a row."""
    names = (
        "plant",
        "readings",
        "observer",
        "rms z - r",
        "ratio to known gaps",
        "rms z - z^",
        "error of the gap, median, 90 %, max [%]",
        "gap, sides covered",
    )
    lines = ["## Play\n", *head(*names)]
    for place in plants:
        for reading in readings:
            lines += _rows(place, WORLDS[place], reading, loops)
    about = (
        f"{loops} loops a row with random gaps and starts; the last fifth of each is judged. Gap: "
        "c_r + c_l. Ratio: of the rms of z - r to that of a filter that knows the gaps, median "
        "with a 95 % interval. Covered: by claimed 95 % intervals. Noise and quantum in shares of "
        "the reference's amplitude.\n"
    )
    return "\n".join([*lines, "", about])


def _rows(place: str, world: World, reading: str, loops: int) -> list[str]:
    """The rows of one plant and one kind of readings."""
    lines, best = [], None
    for name, (options, mistaken) in OBSERVERS.items():
        if options is certified and world.gains is None:
            continue
        each = [posed(world, reading, options, mistaken, seed) for seed in range(loops)]
        ran = run_loops(each, 0.8 * world.duration)
        best = ran.rms if best is None else best
        cells = [*errors(ran.rms, best), f"{np.median(ran.hidden):.3g}"]
        cells += _of_gaps(ran) if name not in ("gaps known", "y taken for z") else ["", ""]
        lines.append(row(place, reading, name, *cells))
    return lines


def errors(rms: np.ndarray, best: np.ndarray) -> list[str]:
    """The median of an rms, and of its ratio to the best one with a 95 % interval."""
    return ratio_cells(rms, best)[:2]


def _of_gaps(ran: Loops) -> list[str]:
    """The errors of the gaps, and how often they are covered."""
    wrong = ran.errors.sum(axis=1)
    share = 100 * np.abs(wrong) / ran.width
    size = f"{np.median(share):.1f}, {np.quantile(share, 0.9):.1f}, {share.max():.1f}"
    if not ran.width_std.size:
        return [size, ""]
    return [size, f"{np.mean(np.abs(wrong) <= 1.96 * ran.width_std):.2f}, {ran.covered()}"]
