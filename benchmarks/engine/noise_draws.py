"""Noise in the lanes: what a number costs beside NumPy's, and how many lie far out."""

from __future__ import annotations

import numpy as np
from scipy import stats

from benchmarks.markdown import head, row
from benchmarks.timing import medians
from undeadzone.compile import lanes, normal
from undeadzone.signals import noise

STEPS, CHANNELS = 512, 2
NUMBERS = 400_000_000
SIGMAS = (3.0, 4.0, 5.0)
ALONE = 20_000  # numbers of one run


def table(rounds: int = 30) -> str:
    """Medians over interleaved rounds, one thread, after one round that compiles."""
    numbers = np.empty((STEPS, CHANNELS, lanes.WIDTH))
    words = [noise.counter_word(noise.AFTER, channel) for channel in range(CHANNELS)]
    state, colour = np.empty((CHANNELS, lanes.WIDTH)), noise.first_order_coefficients(0.5, 1e-3)
    generator = np.random.default_rng(0)
    draws = {
        "numpy's `Generator.standard_normal`": lambda: generator.standard_normal(out=numbers),
        "numpy, `noise.gaussian`, one run": lambda: noise.standard_normal_numbers(
            0, noise.AFTER, ALONE, 1
        ),
        f"lanes, {lanes.WIDTH} runs": lambda: normal.fill_normal(
            numbers, 0, 0, words, range(lanes.WIDTH)
        ),
        "lanes, colouring besides": lambda: normal.colour_noise(numbers, state, 0, *colour),
    }
    counts = (numbers.size, ALONE, numbers.size, numbers.size)
    seconds = medians(draws, rounds, uncounted=1)
    each = [value / count for value, count in zip(seconds.values(), counts, strict=True)]
    rows = []
    for name, value in zip(draws, each, strict=True):
        rows.append(row(name, f"{1e9 * value:.2g}", f"{each[0] / value:.2g}"))
    return "\n".join(
        [
            "## Noise\n",
            *head("standard normal numbers", "ns per number", "times faster than numpy"),
            *rows,
            f"\nOf {NUMBERS:.0e} numbers beyond, on either side:\n",
            *head("sigma", "expected", "found", "deviation, standard deviations"),
            *_tails(words),
            "",
        ]
    )


def _tails(words: list[int]) -> list[str]:
    """How many numbers lie beyond so many sigma, and how many should."""
    numbers = np.empty((STEPS, CHANNELS, lanes.WIDTH))
    beyond = dict.fromkeys(SIGMAS, 0)
    blocks = -(-NUMBERS // numbers.size)
    for block in range(blocks):
        runs = range(block * lanes.WIDTH, (block + 1) * lanes.WIDTH)
        normal.fill_normal(numbers, 0, 1, words, runs)
        far = np.abs(numbers[np.abs(numbers) > min(SIGMAS)])
        for sigma in SIGMAS:
            beyond[sigma] += np.count_nonzero(far > sigma)
    rows = []
    for sigma, count in beyond.items():
        share = 2 * stats.norm.sf(sigma)
        expected = share * blocks * numbers.size
        deviation = (count - expected) / np.sqrt(expected * (1 - share))
        rows.append(row(f"{sigma:g}", f"{expected:.6g}", f"{count}", f"{deviation:+.2f}"))
    return rows
