"""Standard normal numbers for many runs at once, a run to a lane.

They are the bits of `noise.gaussian` and `noise.coloured`.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from undeadzone.compile import cache, philox
from undeadzone.compile.graph import LANES, SHARED, STEADY, Node, Nodes, used
from undeadzone.compile.machine import here
from undeadzone.compile.print_llvm import TYPES, Names, Text, in_lanes, once
from undeadzone.compile.schedule import of_graph
from undeadzone.compile.trace import Numpy, Value
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


# The arguments of both kernels, by name.
_FILL: Final = {
    **dict.fromkeys(("steps", "channels", "lanes"), "int64"),
    **{"numbers": "float64*", "first": "int64", "key": "uint64"},
    **{"words": "uint32*", "runs": "uint64*"},
}
_COLOUR: Final = {
    **dict.fromkeys(("steps", "channels", "coloured", "lanes"), "int64"),
    **{"numbers": "float64*", "state": "float64*", "first": "int64", "start": "int64"},
    **{"memory": "float64", "drive": "float64"},
}


@functools.cache
def _fill() -> tuple[str, tuple[str, ...]]:
    """Text and arguments of what draws: of 32 bits a vector holds twice as many numbers."""
    return fill_text(2 * here().vector[0]), tuple(_FILL.values())


@functools.cache
def _colour() -> tuple[str, tuple[str, ...]]:
    """Text and arguments of what colours."""
    return colour_text(here().vector[0]), tuple(_COLOUR.values())


def _module(arguments: dict[str, str], text: Text) -> str:
    """A module with the function `block` of these arguments."""
    given = []
    for name, kind in arguments.items():
        given.append(f"ptr noalias %{name}" if kind.endswith("*") else f"{TYPES[kind]} %{name}")
    head = f"define void @block({', '.join(given)}) nounwind {{\nentry:"
    return "\n".join([head, *text.lines, "  ret void", "}", *text.declared.values()])


def _parts(text: Text, group: int) -> Iterator[str]:
    """Print loops over whole groups of runs, and over those that are left; their counts."""
    for name, lanes, begin, end in (("many", group, "0", "%whole"), ("few", 1, "%whole", "%lanes")):
        text.lanes = lanes
        with text.loop(name, begin, end, lanes) as loop:
            yield loop.at
    text.lanes = 1


def fill_text(group: int) -> str:
    """The text of what fills an array with normal numbers, a group of runs at a time."""
    results = _numbers()
    text, order = Text(1, {}), of_graph(results)
    text.block = "entry"
    below = [*used(order, results, STEADY), *used(order, results, SHARED)]
    last = text.add("add i64 %first, %steps")
    text.line(f"%whole = and i64 %lanes, -{group}")
    row = text.add("mul i64 %channels, %lanes")
    begin, rounded = text.add("udiv i64 %first, 4"), text.add(f"add i64 {last}, 3")
    with text.loop("four", begin, text.add(f"udiv i64 {rounded}, 4")) as four:
        rows = [_row(text, four.at, i, last, row) for i in range(len(results))]
        with text.loop("channel", "0", "%channels") as channel:
            address = text.add(f"getelementptr i32, ptr %words, i64 {channel.at}")
            word = text.add(f"zext i32 {text.load(address, 'i32')} to i64")
            start = text.add(f"mul i64 {channel.at}, %lanes")
            have: dict[Node, str] = {}
            given = {"key": "%key", "counter": four.at, "word": word}
            once(text, below, have, lambda node: given[node.text])
            for count in _parts(text, group):
                (names,) = in_lanes(text, order, [_source(text, have, count)], False)
                at = text.add(f"add i64 {start}, {count}")
                for node, (asked, first) in zip(results, rows, strict=True):
                    with text.where(asked, f"of{text.lanes}.{node.number}"):
                        place = text.add(f"add i64 {first}, {at}")
                        text.store(names(node), text.at("%numbers", place), vector=True)
    return _module(_FILL, text)


def _numbers() -> list[Node]:
    """The four numbers of a counter, as doubles."""
    nodes = Nodes()
    m = Numpy(nodes)

    def given(name: str, level: int) -> Value:
        return Value(nodes, nodes.input(name, level, "uint64"))

    run, key = given("run", LANES), given("key", STEADY)
    low, high = run & philox.LOW, run >> philox.HALF
    words = philox.philox(given("counter", SHARED), given("word", SHARED), low, high, key, m)
    numbers = [*philox.box_muller(words[0], words[1], m), *philox.box_muller(words[2], words[3], m)]
    return [m.float64(number).node for number in numbers]


def _row(text: Text, counter: str, i: int, last: str, row: str) -> tuple[str, str]:
    """Print whether the i-th step of a counter is asked for, and where its numbers begin."""
    k = text.add(f"add i64 {text.add(f'mul i64 {counter}, 4')}, {i}")
    late, early = text.add(f"icmp ule i64 %first, {k}"), text.add(f"icmp ult i64 {k}, {last}")
    asked = text.add(f"and i1 {late}, {early}")
    return asked, text.add(f"mul i64 {text.add(f'sub i64 {k}, %first')}, {row}")


def _source(text: Text, have: dict[Node, str], count: str) -> Names:
    """What names the runs' numbers, and what all lanes share."""

    def source(node: Node) -> str:
        if node.level == LANES:
            return text.load(text.at("%runs", count), "i64", vector=True)
        return text.splat(have[node], TYPES[node.kind])

    return source


def colour_text(group: int) -> str:
    """The text of what makes first-order noise of white noise, a group of runs at a time."""
    text = Text(1, {})
    text.block = "entry"
    text.line(f"%whole = and i64 %lanes, -{group}")
    row = text.add("mul i64 %channels, %lanes")
    with text.loop("channel", "0", "%coloured") as channel:
        state = text.add(f"mul i64 {channel.at}, %lanes")
        number = text.add(f"add i64 {channel.at}, %start")
        at = text.add(f"mul i64 {number}, %lanes")
        for count in _parts(text, group):
            _coloured(text, text.add(f"add i64 {state}, {count}"), at, count, row)
    return _module(_COLOUR, text)


def _coloured(text: Text, state: str, at: str, count: str, row: str) -> None:
    """Print a loop over steps for some runs: the very first number stays as it is."""
    vector, last = text.type("double"), f"%last{text.lanes}"
    memory, drive = text.splat("%memory", "double"), text.splat("%drive", "double")
    address = text.at("%state", state)
    before = text.load(address, vector=True)
    with text.loop(f"step{text.lanes}", "0", "%steps") as step:
        place = text.add(f"add i64 {text.add(f'mul i64 {step.at}, {row}')}, {at}")
        to = text.at("%numbers", text.add(f"add i64 {place}, {count}"))
        white = text.load(to, vector=True)
        kept = text.add(f"fmul {vector} {memory}, {last}")
        driven = text.add(f"fmul {vector} {drive}, {white}")
        both = text.add(f"fadd {vector} {kept}, {driven}")
        later = text.add(f"icmp sgt i64 {text.add(f'add i64 %first, {step.at}')}, 0")
        new = text.add(f"select i1 {later}, {vector} {both}, {vector} {white}")
        text.store(new, to, vector=True)
        step.carried.append((last, vector, before, new))
    text.store(last, address, vector=True)
