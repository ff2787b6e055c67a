"""Standard normal numbers for many runs at once, a run to a lane: the bits of `noise.gaussian` and `noise.coloured`."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np

from undeadzone.arrays import Floats, Integers
from undeadzone.engine import cache, philox
from undeadzone.errors import ShapeError

# A loop is vectorised for the widest number that it loads or stores: where that is 32 bits, twice as many lanes go at once.
_FILL = '''{philox}
from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def select(context, condition, yes, no):
    """yes where the condition holds, else no, without a branch."""
    return yes(types.boolean, yes, yes), lambda context, builder, signature, args: builder.select(*args)


philox = njit(forceinline=True)(philox)
box_muller = njit(forceinline=True, error_model="numpy")(box_muller)


@njit("void(float64[:, :, ::1], int64, uint64, uint32[::1], uint64[::1])", error_model="numpy", nogil=True, cache="__file__" in globals())
def block(numbers, first, key, words, runs):
    low, high, drawn = np.empty({width}, np.uint32), np.empty({width}, np.uint32), np.empty((4, {width}), np.float32)
    for j in range({width}):
        low[j], high[j] = np.uint32(runs[j] & LOW), np.uint32(runs[j] >> HALF)
    last = first + len(numbers)
    for four in range(first // 4, (last + 3) // 4):
        for channel in range(len(words)):
            word = np.uint64(words[channel])
            for j in range({width}):
                a, b, c, d = philox(np.uint64(four), word, np.uint64(low[j]), np.uint64(high[j]), key)
                drawn[0, j], drawn[1, j] = box_muller(a, b)
                drawn[2, j], drawn[3, j] = box_muller(c, d)
            for k in range(max(first, 4 * four), min(last, 4 * four + 4)):
                row, new = numbers[k - first, channel], drawn[k - 4 * four]
                for j in range({width}):
                    row[j] = new[j]
'''

_COLOUR = """
from numba import njit


@njit("void(float64[:, :, ::1], float64[:, ::1], int64, int64, float64, float64)", nogil=True, cache="__file__" in globals())
def block(numbers, state, first, start, memory, drive):
    for k in range(len(numbers)):
        for channel in range(len(state)):
            row, last = numbers[k, start + channel], state[channel]
            if first + k > 0:
                for j in range({width}):
                    row[j] = memory * last[j] + drive * row[j]
            for j in range({width}):
                last[j] = row[j]
"""


def fill(numbers: Floats, first: int, seed: int, words: Sequence[int], runs: Sequence[int] | Integers) -> None:
    """Write standard normal numbers into `numbers` (steps x channels x lanes, contiguous), those of steps first, first + 1, ...

    words: `noise.word` of each channel; runs: the run's number in each lane. Raises ShapeError.
    """
    found = len(words), len(runs)
    if numbers.shape[1:] != found:
        raise ShapeError(f"numbers: expected steps x {found[0]} channels x {found[1]} lanes, found {' x '.join(map(str, numbers.shape))}")
    _kernel(_FILL, len(runs))(numbers, first, np.uint64(seed), np.asarray(words, np.uint32), np.asarray(runs, np.uint64))


def colour(numbers: Floats, state: Floats, first: int, start: int, memory: float, drive: float) -> None:
    """Make first-order noise, in place, of white noise in channels start, start + 1, ... of `numbers`, as `fill` left them.

    state: the last numbers (coloured channels x lanes), overwritten; at step 0 it is not read. memory, drive: `noise.colour`.
    Raises ShapeError.
    """
    _, channels, width = numbers.shape
    if state.shape[1:] != (width,) or not 0 <= start <= start + len(state) <= channels:
        raise ShapeError(f"state: expected at most {channels - start} channels x {width} lanes, found {' x '.join(map(str, state.shape))}")
    _kernel(_COLOUR, width)(numbers, state, first, start, memory, drive)


@functools.lru_cache(maxsize=16)
def _kernel(template: str, width: int) -> Any:
    return cache.load(template.format(width=width, philox=inspect.getsource(philox)))
