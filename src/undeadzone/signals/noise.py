"""Seeded Gaussian numbers, an independent stream per purpose and channel.

Each is a function of its place alone. The key of a Philox counter is the seed, and its words are
step // 4, stream and channel, and the run's number. Run 0 is the scenario on its own. Run k of an
ensemble draws as run k, also when it is replayed alone. `engine.normal` draws the same numbers, bit
for bit, for many runs at once.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from undeadzone.compile.philox import LOW, box_muller, philox
from undeadzone.util.arrays import Floats

# The streams: noise after and ahead of the dead zone, disturbance, drift of the widths, lost
# readings.
AFTER, BEFORE, DISTURBANCE, WEAR, LOSS = range(5)


class FirstOrderNoise(NamedTuple):
    """First-order noise of unit rms: y_0 = g_0, y_k = memory y_k-1 + drive g_k, g standard
    normal.

    Attributes:
        memory: share of a number that is left after a step [1].
        drive: gain of the white noise [1].
    """

    memory: float
    drive: float


def counter_word(stream: int, channel: int) -> int:
    """Return the second word of the counter."""
    return stream << 24 | channel


def standard_normal_numbers(
    seed: int, stream: int, samples: int, channels: int, run: int = 0
) -> Floats:
    """Return standard normal numbers, functions of (seed, run, stream, channel, sample) alone.

    Args:
        seed: from 0 to 2^64 - 1.
        stream: one of the streams, such as `AFTER`.
        samples: number of samples per channel.
        channels: number of channels.
        run: number of the run, from 0 to 2^64 - 1.

    Returns:
        The numbers (samples x channels).
    """
    fours = np.arange(-(-samples // 4), dtype=np.uint64)[:, None]
    words = np.array([counter_word(stream, channel) for channel in range(channels)], np.uint64)
    a, b, c, d = philox(fours, words, np.uint64(run) & LOW, np.uint64(run >> 32), np.uint64(seed))
    four = np.stack([*box_muller(a, b), *box_muller(c, d)], axis=1)
    return four.reshape(4 * fours.size, channels)[:samples].astype(float)


def first_order_coefficients(correlation: float, step: float) -> FirstOrderNoise:
    """Return the first-order noise of a correlation time [s] on a grid of `step` [s]."""
    memory = math.exp(-step / correlation)
    return FirstOrderNoise(memory, math.sqrt(1 - memory**2))


def stationary_first_order_noise(
    seed: int, samples: int, rms: Floats, correlation: float, step: float, run: int = 0
) -> Floats:
    """Return first-order Gaussian noise, stationary from the start (samples x channels).

    Args:
        seed: seed of the numbers.
        samples: number of samples per channel.
        rms: rms of the noise (channels).
        correlation: correlation time [s].
        step: between samples [s].
        run: number of the run.

    Returns:
        The noise (samples x channels).
    """
    memory, drive = first_order_coefficients(correlation, step)
    white = standard_normal_numbers(seed, DISTURBANCE, samples, rms.size, run)
    white[1:] *= drive

    def following(last: float, new: float) -> float:
        """Return the next value of the noise."""
        return memory * last + new

    columns = [list(accumulate(column.tolist(), following)) for column in white.T]
    return np.reshape(columns, white.T.shape).T * rms
