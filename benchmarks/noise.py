"""Noise in the lanes: what a number costs beside NumPy's, and how many of 4e8 lie beyond 3, 4 and 5 sigma."""

from __future__ import annotations

import statistics
import time

import numpy as np
from scipy import stats

from undeadzone.engine import lanes, normal
from undeadzone.signals import noise

STEPS, CHANNELS = 512, 2
NUMBERS = 400_000_000


def table(rounds: int = 30) -> str:
    """Medians over interleaved rounds, one thread."""
    numbers, words = (
        np.empty((STEPS, CHANNELS, lanes.WIDTH)),
        [noise.word(noise.AFTER, channel) for channel in range(CHANNELS)],
    )
    state, colour, generator = (
        np.empty((1, lanes.WIDTH)),
        noise.colour(0.5, 1e-3),
        np.random.default_rng(0),
    )
    draws = {
        "numpy's `Generator.standard_normal`": (
            numbers.size,
            lambda: generator.standard_normal(out=numbers),
        ),
        "numpy, `noise.gaussian`, one run": (
            20_000,
            lambda: noise.gaussian(0, noise.AFTER, 20_000, 1),
        ),
        f"lanes, {lanes.WIDTH} runs": (
            numbers.size,
            lambda: normal.fill(numbers, 0, 0, words, range(lanes.WIDTH)),
        ),
        "lanes, colouring besides": (
            numbers.size // CHANNELS,
            lambda: normal.colour(numbers, state, 0, 0, *colour),
        ),
    }
    times: dict[str, list[float]] = {name: [] for name in draws}
    for k in range(rounds + 1):
        for name, (count, draw) in draws.items():
            began = time.perf_counter()
            draw()
            if k > 0:  # the first round compiles
                times[name].append((time.perf_counter() - began) / count)
    medians = {name: statistics.median(values) for name, values in times.items()}
    unit = next(iter(medians.values()))
    return "\n".join(
        [
            "## Noise\n\n| standard normal numbers | ns per number | times faster than numpy |\n|---|---|---|",
            *(
                f"| {name} | {1e9 * value:.2g} | {unit / value:.2g} |"
                for name, value in medians.items()
            ),
            f"\nOf {NUMBERS:.0e} numbers beyond, on either side:\n\n| sigma | expected | found | deviation, standard deviations |\n|---|---|---|---|",
            *_tails(words),
            "",
        ]
    )


def _tails(words: list[int]) -> list[str]:
    numbers, found = np.empty((STEPS, CHANNELS, lanes.WIDTH)), dict.fromkeys((3.0, 4.0, 5.0), 0)
    blocks = -(-NUMBERS // numbers.size)
    for block in range(blocks):
        normal.fill(numbers, 0, 1, words, range(block * lanes.WIDTH, (block + 1) * lanes.WIDTH))
        far = np.abs(numbers[np.abs(numbers) > min(found)])
        found = {sigma: count + np.count_nonzero(far > sigma) for sigma, count in found.items()}
    rows = []
    for sigma, count in found.items():
        share = 2 * stats.norm.sf(sigma)
        expected = share * blocks * numbers.size
        rows.append(
            f"| {sigma:g} | {expected:.6g} | {count} | {(count - expected) / np.sqrt(expected * (1 - share)):+.2f} |"
        )
    return rows
