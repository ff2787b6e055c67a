"""Standard normal numbers for many runs at once, a run to a lane.

They are the bits of `noise.gaussian` and `noise.coloured`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from undeadzone.engine import cache, draws
from undeadzone.engine.machine import here
from undeadzone.errors import ShapeError
from undeadzone.support.arrays import Floats, Integers, shape_text


def fill(
    numbers: Floats, first: int, seed: int, words: Sequence[int], runs: Sequence[int] | Integers
) -> None:
    """Write standard normal numbers into an array.

    Args:
        numbers: filled (steps x channels x lanes), contiguous.
        first: number of the first step.
        seed: of the noise.
        words: `noise.word` of each channel.
        runs: the run's number in each lane.

    Raises:
        ShapeError: an array of other channels or lanes.
    """
    channels, lanes = len(words), len(runs)
    if numbers.shape[1:] != (channels, lanes):
        raise ShapeError(
            f"numbers: expected steps x {channels} channels x {lanes} lanes, "
            f"found {shape_text(numbers.shape)}"
        )
    kernel = cache.load(*_fill())
    streams, lane_runs = np.asarray(words, np.uint32), np.asarray(runs, np.uint64)
    kernel(*numbers.shape, numbers, first, seed, streams, lane_runs)


def colour(
    numbers: Floats, state: Floats, first: int, start: int, memory: float, drive: float
) -> None:
    """Make first-order noise of white noise, in place.

    Args:
        numbers: as `fill` left them (steps x channels x lanes).
        state: the last numbers (coloured channels x lanes), overwritten; at step 0 it is not read.
        first: number of the first step.
        start: the first channel that is coloured.
        memory, drive: `noise.colour`.

    Raises:
        ShapeError: a state of other channels or lanes.
    """
    steps, channels, width = numbers.shape
    if state.shape[1:] != (width,) or not 0 <= start <= start + len(state) <= channels:
        raise ShapeError(
            f"state: expected at most {channels - start} channels x {width} lanes, "
            f"found {shape_text(state.shape)}"
        )
    kernel = cache.load(*_colour())
    kernel(steps, channels, len(state), width, numbers, state, first, start, memory, drive)


@functools.cache
def _fill() -> tuple[str, tuple[str, ...]]:
    """Text and arguments of what draws: of 32 bits a vector holds twice as many numbers."""
    return draws.fill(2 * here().vector[0]), draws.FILL


@functools.cache
def _colour() -> tuple[str, tuple[str, ...]]:
    """Text and arguments of what colours."""
    return draws.colour(here().vector[0]), draws.COLOUR
