"""What a limited range of the readings costs: closed loops, and coverage of claimed intervals.

The limit of every problem is where the asked share of its readings is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from benchmarks.filters import coverage
from benchmarks.filters.problems.random_plants import RANGE, STEP, WORLDS, Problems, problems
from benchmarks.loops.plants.random_loops import (
    Loops,
    random_plant,
    ratio_cells,
    run_loops,
    white_censored,
)
from benchmarks.markdown import head, row
from undeadzone.controllers import StateFeedback
from undeadzone.interfaces import Reading, to_reading
from undeadzone.nonlinearities.limits import Limits
from undeadzone.nonlinearities.sensor import Sensor, deadzone
from undeadzone.observers import Censored, Certified, Kalman
from undeadzone.registry import ObserverOptions
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.schema import Scenario, Simulation
from undeadzone.signals.exosystem import Random, Sine
from undeadzone.util.arrays import Floats

SHARES = (0.44, 0.12, 0.02)  # of the readings that are exact
AMPLITUDE, FREQUENCY, NOISE, DISTURBANCE = 5.0, 0.3, 0.01, 0.5
DURATION, LATE = 30.0, 24.0  # [s] of a loop, and from when it is judged
WIDTHS = (0.3, 1.5)
ASSUMED_RANGE = (0.0, 2.0)


Options = Callable[[Floats], ObserverOptions]
"""Widths [d_r, d_l] -> options of an observer of that loop."""


def censored(right: Any, left: Any) -> Censored:
    """`Censored` told what disturbs it."""
    return white_censored(STEP, right=right, left=left, disturbance=DISTURBANCE)


def knowing(d: Floats) -> Censored:
    """It knows the widths."""
    return censored([d[0] - 1e-6, d[0] + 1e-6], [d[1] - 1e-6, d[1] + 1e-6])


def hearing(d: Floats) -> Censored:
    """It knows a range of the widths."""
    return censored(ASSUMED_RANGE, ASSUMED_RANGE)


def dropping(d: Floats) -> Kalman:
    """It takes readings at a limit for missing."""
    return Kalman(right=ASSUMED_RANGE, disturbance=DISTURBANCE)


def ignoring(d: Floats) -> Kalman:
    """It takes all readings for exact; used where nobody tells it of the range."""
    return Kalman(right=ASSUMED_RANGE, disturbance=DISTURBANCE, glitches=0.0)


def adapting(d: Floats) -> Certified:
    """It adapts the widths with its default gains."""
    return Certified()


OBSERVERS: dict[str, tuple[Options, bool]] = {
    "widths known": (knowing, True),
    "unknown, `censored`": (hearing, True),
    "unknown, `kalman`": (dropping, True),
    "unknown, `certified`": (adapting, True),
    "`kalman`, range not told": (ignoring, False),
}


def limit_for(z: Floats, d: Floats, share: float) -> float:
    """The limit of readings, of which this share is exact along z (samples)."""
    beyond = np.sort(np.abs(deadzone(z, d[0], d[1])))
    silent = int(np.sum(beyond == 0))
    return float(beyond[min(silent + round(share * z.size), z.size - 1)])


def posed(options: Options, is_known: bool, share: float, seed: int) -> Problem:
    """One random loop.

    Args:
        options: of the observer.
        is_known: whether the observer knows the range.
        share: of the readings that are exact if z follows r.
        seed: of everything random.
    """
    rng = np.random.default_rng([seed, 18])
    plant, d = random_plant(rng), rng.uniform(*WIDTHS, 2)
    phase = np.linspace(0.0, 2 * np.pi, 10_000)
    limit = limit_for(AMPLITUDE * np.sin(phase), d, share)
    sensor = Sensor(right=d[0], left=d[1], noise=NOISE, range=[-limit, limit])
    scenario = Scenario(
        plant=plant,
        sensor=sensor,
        reference=Sine(amplitude=AMPLITUDE, frequency=FREQUENCY),
        observer=options(d),
        controller=StateFeedback(poles=[-6.0, -6.5]),
        disturbance=Random(rms=DISTURBANCE, correlation_time=1e-3),
        simulation=Simulation(duration=DURATION, time="sampled", step=STEP, seed=seed),
    )
    problem = resolve_scenario(scenario)
    if is_known:
        return problem
    untold = msgspec.structs.replace(
        problem.sensor, low=-np.ones(1) * np.inf, high=np.ones(1) * np.inf
    )
    return problem._replace(observer=options(d).build(problem.model, untold))


def run(options: Options, is_known: bool, share: float, count: int) -> Loops:
    """Random loops of one observer."""
    return run_loops([posed(options, is_known, share, seed) for seed in range(count)], LATE)


def loops_table(count: int) -> list[str]:
    """The table of closed loops."""
    names = ("exact readings", "observer", "rms z - r", "ratio to known", "90 %", "d_r, d_l")
    lines = head(*names)
    for share in SHARES:
        known = run(*OBSERVERS["widths known"], share, count)
        for name, (options, is_known) in OBSERVERS.items():
            ran = known if name == "widths known" else run(options, is_known, share, count)
            cells = [f"{100 * share:.0f} %", name, *ratio_cells(ran.rms, known.rms)]
            cells.append(ran.covered() if name != "widths known" else "")
            lines.append(row(*cells))
    return lines


def observe(
    options: Callable[[Problems, int], Any], known: Problems, limits: Floats
) -> coverage.Verdict:
    """Run an observer on problems whose readings end at +-limits (K), one lane each."""
    built = []
    for k, model in enumerate(known.models):
        ends = [-limits[k], limits[k]]
        sensor = Sensor(
            right=RANGE[1], left=RANGE[1], noise=known.noise[k], threshold=0.0, range=ends
        )
        built.append(coverage.built_for(options(known, k), model, sensor, STEP))
    y = np.clip(known.y, -limits, limits)
    own = np.stack([y, known.u, np.broadcast_to(limits, y.shape)], axis=1)
    step = coverage.step_of(built[0], ESTIMATES, limited_reading, 3)
    return coverage.final_verdict(known, coverage.run_observers(built, step, own))


def limited_reading(w: Any) -> Reading:
    """The reading y of [y, u, limit]."""
    return to_reading(w[0], 0.0, Limits(-w[2], w[2]))


ESTIMATES = coverage.selected(coverage.FINAL)


def coverage_table(count: int, seed: int) -> list[str]:
    """The table of coverage."""
    names = ("world", "exact readings", "filter", "d_r", "d_l", "width", "centre", "z", "std")
    lines = head(*names)
    for world in WORLDS:
        for order in (1, 2):
            lines += _rows(world, order, problems("both edges", WORLDS[world], order, count, seed))
    return lines


def _rows(world: str, order: int, known: Problems) -> list[str]:
    """The rows of one family of problems."""
    lines = []
    free = np.abs(known.y).max() * 10 * np.ones(known.y.shape[1])
    limits = {"all": free}
    for share in SHARES[1:]:
        each = [limit_for(z, d, share) for z, d in zip(known.z.T, known.d, strict=True)]
        # Nearer to silence than noise reaches, no range is sensible.
        limits[f"{100 * share:.0f} %"] = np.maximum(each, 12 * known.noise)
    for name, options in {"kalman": coverage.kalman, "censored": coverage.censored}.items():
        usual = None
        for share, ends in limits.items():
            verdict = observe(options, known, ends)
            usual = verdict.stds if usual is None else usual
            shares = [f"{part:.2f}" for part in verdict.covered()]
            wider = float(np.median(verdict.stds[:, 2] / usual[:, 2]))
            lines.append(row(f"{world}, order {order}", share, name, *shares, f"{wider:.2f}"))
    return lines


def table(loops: int = 40, count: int = 200, seed: int = 0) -> str:
    """Both tables, of that many loops and problems a row."""
    about_loops = (
        f"{loops} random loops a row of second order: |r| = {AMPLITUDE:g}, {FREQUENCY:g} Hz, "
        f"{1 / STEP:g} Hz, noise {NOISE:g}, white disturbance of {DISTURBANCE:g} rms, widths of "
        f"{WIDTHS[0]:g} to {WIDTHS[1]:g}, {DURATION:g} s, judged from {LATE:g} s on. Ratio: of the "
        "rms of z - r to that with known widths and the same range, median with a 95 % interval, "
        "and 90 % quantile. d_r, d_l: coverage of claimed 95 % intervals.\n"
    )
    about_coverage = (
        f"{count} problems a row, as under coverage above, z reaches both edges. std: claimed "
        "deviation of the width over that without a range, median."
    )
    parts = ["## Readings that end\n", *loops_table(loops), "", about_loops]
    return "\n".join([*parts, *coverage_table(count, seed), "", about_coverage, ""])
