"""Peaks of the alarm's cumulative sum in honest runs of `auto`, the longest of which are shown."""

from __future__ import annotations

from itertools import accumulate

import numpy as np

import undeadzone as uz
from benchmarks.markdown import head, row
from undeadzone.plants.build import system
from undeadzone.plants.system import time_scale
from undeadzone.simulation.consistency import PEAK
from undeadzone.util.arrays import Floats

PLANTS = {
    "two equal poles": uz.Plant(companion=[1.0, 2.0]),
    "damping 0.25": uz.Plant(companion=[1.0, 0.5]),
    "one pole": uz.Plant(companion=[1.0]),
}
SAMPLES = 16  # in a quarter period


def honest(plant: uz.Plant, told: bool, seed: int, quarters: float) -> Floats:
    """Return the peaks of the sum in a run, the largest first [quarter periods]."""
    quarter = time_scale(system(plant).linear)
    right, left = np.random.default_rng(1000 + seed).uniform(0.4, 1.5, 2)
    claims = {"disturbance": 0.2, "correlation_time": quarter, "bias": 0.0, "tolerance": 0.0}
    waves = [(1.8 * right + 0.4, 0.5), (0.7, 0.17)]
    run = uz.simulate(
        uz.Scenario(
            plant=plant,
            sensor=uz.Sensor(right=right, left=left, noise=0.02),
            reference=uz.Sines(
                components=[uz.Sine(amplitude=a, frequency=f / quarter) for a, f in waves]
            ),
            disturbance=uz.Random(rms=[0.2], correlation_time=quarter),
            observer=uz.Auto(right=[0.3, 2.0], left=[0.3, 2.0], **(claims if told else {})),
            controller=uz.StateFeedback(speed=2 / quarter),
            simulation=uz.Simulation(
                time="sampled", step=quarter / SAMPLES, duration=quarters * quarter, seed=seed
            ),
        ),
        check_step=False,
    )
    changes = (1 - 2 * (run.consistent[:, 0] > 0.5)).tolist()
    sums = np.array(list(accumulate(changes, lambda s, change: max(s + change, 0))))
    starts = np.flatnonzero(np.diff(sums > 0, prepend=False) & (sums > 0))
    return np.sort(np.maximum.reduceat(sums, starts))[::-1] / SAMPLES


def table(seeds: int = 2, quarters: float = 40_000.0) -> str:
    """Return the table: peaks, and the mean excess over the tenth largest."""
    lines = head("plant", "assumptions", "peaks", "largest", "tenth", "mean excess")
    for name, plant in PLANTS.items():
        for told in (True, False):
            runs = [honest(plant, told, 10 + seed, quarters) for seed in range(seeds)]
            top = np.sort(np.concatenate([*runs, np.zeros(10)]))[::-1][:10]
            numbers = [f"{value:.1f}" for value in (top[0], top[-1], (top - top[-1])[:9].mean())]
            lines.append(
                row(name, "told" if told else "ranges", str(sum(map(len, runs))), *numbers)
            )
    return "\n".join(["## Alarm", "", f"The alarm assumes a mean excess of {PEAK:g}.", "", *lines])
