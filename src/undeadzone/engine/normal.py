"""Standard normal numbers for many runs at once, a run to a lane.

They are the bits of `noise.gaussian` and `noise.coloured`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from undeadzone.engine import cache, philox
from undeadzone.errors import ShapeError
from undeadzone.support.arrays import Floats, Integers, shape_text


class Template(NamedTuple):
    """A function to compile.

    Attributes:
        kinds: of its arguments (`cache.load`).
        text: its source, with places for the number of lanes and the text of `philox`.
    """

    kinds: tuple[str, ...]
    text: str


# A loop is vectorised for the widest number that it loads or stores: where that is 32 bits, twice
# as many lanes go at once.
_FILL = Template(
    ("int64", "int64", "float64*", "int64", "uint64", "uint32*", "uint64*", "uint32*", "float32*"),
    '''{philox}
from numba import carray, njit, types
from numba.extending import intrinsic


@intrinsic
def select(context, condition, yes, no):
    """yes where the condition holds, else no, without a branch."""

    def selected(context, builder, signature, args):
        return builder.select(*args)

    return yes(types.boolean, yes, yes), selected


philox = njit(forceinline=True)(philox)
box_muller = njit(forceinline=True, error_model="numpy")(box_muller)


def block(steps, channels, numbers, first, key, words, runs, halves, drawn):
    numbers = carray(numbers, (steps, channels, {width}))
    words, runs = carray(words, channels), carray(runs, {width})
    halves, drawn = carray(halves, (2, {width})), carray(drawn, (4, {width}))
    low, high = halves[0], halves[1]
    for j in range({width}):
        low[j], high[j] = np.uint32(runs[j] & LOW), np.uint32(runs[j] >> HALF)
    last = first + steps
    for four in range(first // 4, (last + 3) // 4):
        counter = np.uint64(four)
        for channel in range(channels):
            word = np.uint64(words[channel])
            for j in range({width}):
                a, b, c, d = philox(counter, word, np.uint64(low[j]), np.uint64(high[j]), key)
                drawn[0, j], drawn[1, j] = box_muller(a, b)
                drawn[2, j], drawn[3, j] = box_muller(c, d)
            for k in range(max(first, 4 * four), min(last, 4 * four + 4)):
                row, new = numbers[k - first, channel], drawn[k - 4 * four]
                for j in range({width}):
                    row[j] = new[j]
''',
)

_COLOUR = Template(
    ("int64", "int64", "int64", "float64*", "float64*", "int64", "int64", "float64", "float64"),
    """
from numba import carray


def block(steps, channels, coloured, numbers, state, first, start, memory, drive):
    numbers, state = carray(numbers, (steps, channels, {width})), carray(state, (coloured, {width}))
    for k in range(steps):
        for channel in range(coloured):
            row, last = numbers[k, start + channel], state[channel]
            if first + k > 0:
                for j in range({width}):
                    row[j] = memory * last[j] + drive * row[j]
            for j in range({width}):
                last[j] = row[j]
""",
)


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
    kernel = _kernel(_FILL, lanes)
    kernel(
        *numbers.shape[:2],
        numbers,
        first,
        seed,
        np.asarray(words, np.uint32),
        np.asarray(runs, np.uint64),
        np.empty((2, lanes), np.uint32),
        np.empty((4, lanes), np.float32),
    )


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
    kernel = _kernel(_COLOUR, width)
    kernel(steps, channels, len(state), numbers, state, first, start, memory, drive)


@functools.lru_cache(maxsize=16)
def _kernel(template: Template, width: int) -> cache.Block:
    """A template compiled for so many lanes."""
    text = template.text.format(width=width, philox=inspect.getsource(philox))
    return cache.load(text, template.kinds)
