"""Seeded Gaussian numbers, one independent stream per purpose and channel."""

from __future__ import annotations

import numpy as np

from undeadzone.arrays import Floats

AFTER, BEFORE, DISTURBANCE = 0, 1, 2


def gaussian(seed: int, stream: int, samples: int, channels: int, run: int = 0) -> Floats:
    """samples x channels standard normal numbers, a function of (seed, run, stream, channel, sample) alone."""
    columns = [np.random.Generator(np.random.Philox(key=seed, counter=[0, run, stream, channel])).standard_normal(samples) for channel in range(channels)]
    return np.stack(columns, axis=1) if columns else np.empty((samples, 0))


def coloured(seed: int, samples: int, rms: Floats, correlation: float, step: float) -> Floats:
    """First-order Gaussian noise of given rms and correlation time [s] on a grid of `step` [s], stationary from the start."""
    from scipy.signal import lfilter

    white = gaussian(seed, DISTURBANCE, samples, rms.size)
    memory = np.exp(-step / correlation)
    white[1:] *= np.sqrt(1 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], white, axis=0)) * rms
