"""Regret of methods on random closed loops that no tuning has seen: plants, widths, gusts, models.

Are numbers that tuning finds better than the plain claims? Those of `censored` were not. And how
much of a regret could a better filter save? Beside the methods stand loops of which more is known.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from benchmarks.filters.problems.random_plants import companion, polynomial, stable_poles
from benchmarks.markdown import head, row
from undeadzone.controllers import StateFeedback
from undeadzone.nonlinearities.sensor import Sensor
from undeadzone.observers import Censored
from undeadzone.observers.filtering.prior import Assumptions
from undeadzone.plants.options import Plant
from undeadzone.scenario.schema import Model, Scenario, Simulation
from undeadzone.signals.exosystem import Random, Sines, Tone
from undeadzone.util.arrays import Floats
from undeadzone_arena.contest.leaderboard import FRAME, NAIVE, compute_regrets
from undeadzone_arena.contest.methods import METHODS, Knob, Method
from undeadzone_arena.contest.trials import score_methods

COUNT = int(os.environ.get("CLOSED_LOOPS", "24"))
RANGE = (0.3, 2.0)  # declared range of the widths, from which they are drawn evenly
STEP, DURATION = 0.01, 15.0  # [s]
TOLERANCE = 0.05  # claimed and true relative rms error of the model
KNOWN = 1e-3  # half the declared range of a width that is as good as known
SHAKEN = (0.25, 2.0)  # true rms of the gust, in the claimed one
# What tuning on the arena's own scenarios found for `censored`; the drift is in largest widths.
TUNED = {"observer.disturbance": 4.497, "observer.drift": 0.004148, "observer.tolerance": 0.05218}


NOTE = (
    f"`widths known`: the observer has the widths to {KNOWN:g}. `widths and gust known`: it also "
    "has the rms of the disturbance, and no bias is assumed. `no zone`: the sensor has widths of "
    f"{KNOWN:g}, and the regret is still in half zones of the loop. Without a zone, the noise and "
    "the effect of a disturbance before it is measured remain."
)


def table() -> str:
    """Median and worst regret of each method, and how often it is behind the plain claims."""
    grounds = {str(seed): loop(np.random.default_rng(seed)) for seed in range(COUNT)}
    found = compute_regrets(score_methods(entrants(), grounds, (0,), numbers={"tuned": TUNED}))
    plain = found["plain claims"]
    for name, easier in EASIER.items():
        found[name] = eased(grounds, easier)
    lines = [
        f"## Regret on {COUNT} random closed loops\n",
        *head("method", "median", "mean", "worst", "behind plain claims, mean", "in"),
    ]
    for name, regret in found.items():
        own = np.where(np.isnan(regret), found[NAIVE], regret)
        behind = own - plain
        mean = f"{behind.mean():+.3f} ± {1.96 * behind.std() / COUNT**0.5:.3f}"
        numbers = [f"{value:.3f}" for value in (np.median(own), own.mean(), own.max())]
        lines.append(row(f"`{name}`", *numbers, mean, f"{100 * (behind > 0).mean():.0f} %"))
    gusts = np.array([shaken(scenario) for scenario in grounds.values()])
    worst = ", ".join(f"{gust:.1f}" for gust in gusts[np.argsort(-np.ravel(plain))][:3])
    correlation = np.corrcoef(np.ravel(plain), gusts)[0, 1]
    lines.append(
        f"\n{NOTE} The rms of z at rest under the disturbance is {np.median(gusts):.2f} half zones "
        f"(median), and in the three worst loops {worst}. Its correlation with the regret is "
        f"{correlation:.2f}."
    )
    return "\n".join(lines) + "\n"


def eased(grounds: dict[str, Scenario], easier: Callable[[Scenario], Scenario]) -> Floats:
    """Regrets of the plain claims on easier loops, in half zones of the loops as they are."""
    loops = {seed: easier(scenario) for seed, scenario in grounds.items()}
    results = []
    for result in score_methods({"plain claims": Method(Censored)}, loops, (0,)):
        sensor = grounds[result.scenario].sensor
        zone = (sensor.right + sensor.left) / 2
        worth = msgspec.structs.replace(result.worth, zone=zone)
        results.append(msgspec.structs.replace(result, worth=worth))
    return compute_regrets(results)["plain claims"]


def with_known_gust(scenario: Scenario) -> Scenario:
    """The loop with known widths, the true rms of the gust, and no bias."""
    known = with_known_widths(scenario)
    gust: Any = scenario.disturbance
    assumptions = msgspec.structs.replace(known.declared, disturbance=gust.rms, bias=0.0)
    return msgspec.structs.replace(known, declared=assumptions)


def without_zone(scenario: Scenario) -> Scenario:
    """The loop behind a sensor that has next to no zone."""
    sensor = msgspec.structs.replace(scenario.sensor, right=KNOWN, left=KNOWN)
    assumptions: Any = scenario.declared
    narrow = msgspec.structs.replace(assumptions, right=[0.0, 2 * KNOWN], left=[0.0, 2 * KNOWN])
    return msgspec.structs.replace(scenario, sensor=sensor, declared=narrow)


def with_known_widths(scenario: Scenario) -> Scenario:
    """The loop with widths that are as good as known."""
    assumptions: Any = scenario.declared
    known = {}
    for name, width in (("right", scenario.sensor.right), ("left", scenario.sensor.left)):
        known[name] = [float(width) - KNOWN, float(width) + KNOWN]
    return msgspec.structs.replace(scenario, declared=msgspec.structs.replace(assumptions, **known))


def shaken(scenario: Scenario) -> float:
    """The rms by which the gust would move z at rest, in half zones."""
    plant: Any = scenario.plant
    disturbance: Any = scenario.disturbance
    half = (scenario.sensor.right + scenario.sensor.left) / 2
    return float(disturbance.rms * _gain(np.array(plant.A), np.array(plant.B)) / half)


EASIER: dict[str, Callable[[Scenario], Scenario]] = {
    "widths known": with_known_widths,
    "widths and gust known": with_known_gust,
    "no zone": without_zone,
}


def entrants() -> dict[str, Method]:
    """The lines, `censored` with plain and with tuned claims, and the cheaper filters."""
    knobs = {
        "observer.disturbance": Knob(0.1, 10.0, "u"),
        "observer.drift": Knob(1e-4, 0.1, "z"),
        "observer.tolerance": Knob(0.01, 0.2),
    }
    lines = {name: METHODS[name] for name in FRAME}
    return lines | {"plain claims": Method(Censored), "tuned": Method(Censored, knobs)}


def loop(rng: np.random.Generator) -> Scenario:
    """A stable plant of order 1 to 3 that follows two tones beyond its zone."""
    order = int(rng.integers(1, 4))
    a = polynomial(stable_poles(rng, order))
    A, B, _ = companion(a, a[0])
    errors = 1 + TOLERANCE * rng.normal(size=(2, order))
    wrong_A, wrong_B = A.copy(), B.copy()
    wrong_A[-1] *= errors[0]
    wrong_B[-1] *= errors[1, 0]
    assumed_rms = float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))) / _gain(A, B)
    share = float(np.exp(rng.uniform(*np.log(SHAKEN))))
    right, left = map(float, rng.uniform(*RANGE, 2))
    tones = [Tone(amplitude=float(a), frequency=float(f)) for a, f in _tones(rng)]
    C: Any = np.eye(order)[:1].tolist()
    return Scenario(
        plant=Plant(A=A.tolist(), B=B.tolist(), C=C),
        model=Model(A=wrong_A.tolist(), B=wrong_B.tolist()),
        sensor=Sensor(right=right, left=left, noise=float(rng.uniform(0.005, 0.1))),
        reference=Sines(components=tones),
        disturbance=Random(rms=share * assumed_rms, correlation_time=0.3),
        declared=Assumptions(
            right=list(RANGE), disturbance=assumed_rms, correlation_time=0.3, tolerance=TOLERANCE
        ),
        controller=StateFeedback(),
        simulation=Simulation(time="sampled", step=STEP, duration=DURATION),
    )


def _tones(rng: np.random.Generator) -> list[tuple[float, float]]:
    """(amplitude, frequency [Hz]) of two tones, a strong slow one and a weak fast one."""
    size, slow = rng.uniform(2.5, 6.0), rng.uniform(0.2, 0.8)
    return [(0.8 * size, slow), (0.2 * size, 2.3 * slow)]


def _gain(A: np.ndarray, B: np.ndarray) -> float:
    """|z / u| at rest."""
    return float(np.abs(np.linalg.solve(A, B))[0, 0])
