"""Standard normal numbers for many runs at once, with a lane for each run.

They are the bits of `noise.gaussian` and `noise.coloured`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from typing import Final

import casadi as ca
import numpy as np

from undeadzone.compile import cache, lanes, philox
from undeadzone.compile.graph import LANES, SHARED, STEADY, Node, Nodes, operands_at_level
from undeadzone.compile.machine import Form, host_machine
from undeadzone.compile.print_llvm import TYPES, Names, Text, print_lanes, print_once
from undeadzone.compile.schedule import lane_instructions
from undeadzone.compile.trace import Numpy, Value
from undeadzone.errors import ShapeError
from undeadzone.util.arrays import Floats, Integers, describe_shape


def fill_normal(
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
    channels = len(words)
    lanes = len(runs)
    if numbers.shape[1:] != (channels, lanes):
        raise ShapeError(
            f"numbers: expected steps x {channels} channels x {lanes} lanes, "
            f"found {describe_shape(numbers.shape)}"
        )
    kernel = cache.load_block(*_fill_program())
    streams = np.asarray(words, np.uint32)
    lane_runs = np.asarray(runs, np.uint64)
    kernel(*numbers.shape, numbers, first, seed, streams, lane_runs)


def colour_noise(numbers: Floats, state: Floats, first: int, memory: float, drive: float) -> None:
    """Convert white noise to first-order coloured noise, in place.

    Args:
        numbers: as `fill_normal` left them (steps x channels x lanes) (at least one step).
        state: the last numbers (channels x lanes), overwritten (at step 0 it is not read).
        first: number of the first step.
        memory, drive: `noise.colour`.

    Raises:
        ShapeError: a state of other channels or lanes.
    """
    if state.shape != numbers.shape[1:]:
        raise ShapeError(
            f"state: expected {describe_shape(numbers.shape[1:])} (channels x lanes), "
            f"found {describe_shape(state.shape)}"
        )
    if first == 0:  # the very first number stays as it is
        state[:] = numbers[0]
    white = numbers[first == 0 :]
    steps = len(white)
    shared = np.zeros(len(white))
    params = np.array([memory, drive])
    coloured = np.empty_like(white)
    block = _colouring_kernel(math.gcd(state.size, host_machine().vector_shape[0])).block
    block(steps, state.size, state, shared, params, white, coloured)
    white[:] = coloured


@functools.cache
def _colouring_kernel(group: int) -> lanes.Kernel:
    """Return the kernel of the colouring filter, with a lane for each channel of each run."""
    last = ca.SX.sym("s")
    white = ca.SX.sym("w")
    params = ca.SX.sym("p", 2)
    new = params[0] * last + params[1] * white
    step = ca.Function("colour", [last, white, params], [new, new])
    return lanes.build_kernel(step, exogenous=[0], form=Form(group, 1, False, 0))


# The arguments of what draws, by name.
_FILL: Final = {
    **dict.fromkeys(("steps", "channels", "lanes"), "int64"),
    **{"numbers": "float64*", "first": "int64", "key": "uint64"},
    **{"words": "uint32*", "runs": "uint64*"},
}


@functools.cache
def _fill_program() -> tuple[str, tuple[str, ...]]:
    """Return text and argument types of the filling function.

    A vector holds twice as many 32-bit numbers.
    """
    return fill_text(2 * host_machine().vector_shape[0]), tuple(_FILL.values())


def _module_text(text: Text) -> str:
    """Return the text of a module with the function `block`."""
    given = []
    for name, kind in _FILL.items():
        given.append(f"ptr noalias %{name}" if kind.endswith("*") else f"{TYPES[kind]} %{name}")
    head = f"define void @block({', '.join(given)}) nounwind {{\nentry:"
    return "\n".join([head, *text.lines, "  ret void", "}", *text.declared.values()])


def _print_run_loops(text: Text, group: int) -> Iterator[str]:
    """Print loops over whole groups of runs and over the remaining runs. Yield their counts."""
    for name, wide, begin, end in (("many", group, "0", "%whole"), ("few", 1, "%whole", "%lanes")):
        text.lanes = wide
        with text.print_loop(name, begin, end, wide) as loop:
            yield loop
    text.lanes = 1


def fill_text(group: int) -> str:
    """Return the text of the function that fills an array with normal numbers, a group of runs
    at a time.
    """
    results = _normal_nodes()
    text = Text(1, {})
    order = lane_instructions(results)
    text.block = "entry"
    below = [*operands_at_level(order, results, STEADY), *operands_at_level(order, results, SHARED)]
    last = text.add("add i64 %first, %steps")
    text.append_line(f"%whole = and i64 %lanes, -{group}")
    row = text.add("mul i64 %channels, %lanes")
    begin = text.add("udiv i64 %first, 4")
    rounded = text.add(f"add i64 {last}, 3")
    with text.print_loop("four", begin, text.add(f"udiv i64 {rounded}, 4")) as four:
        rows = [_print_row_start(text, four, i, last, row) for i in range(len(results))]
        with text.print_loop("channel", "0", "%channels") as channel:
            address = text.add(f"getelementptr i32, ptr %words, i64 {channel}")
            word = text.add(f"zext i32 {text.load(address, 'i32')} to i64")
            start = text.add(f"mul i64 {channel}, %lanes")
            have: dict[Node, str] = {}
            given = {"key": "%key", "counter": four, "word": word}
            print_once(text, below, have, lambda node: given[node.text])
            for count in _print_run_loops(text, group):
                (names,) = print_lanes(text, order, [_run_source(text, have, count)], False)
                at = text.add(f"add i64 {start}, {count}")
                for node, (is_due, first) in zip(results, rows, strict=True):
                    with text.print_if(is_due, f"of{text.lanes}.{node.number}"):
                        place = text.add(f"add i64 {first}, {at}")
                        text.store(names(node), text.address_of("%numbers", place), vector=True)
    return _module_text(text)


def _normal_nodes() -> list[Node]:
    """Return the nodes of the four normal numbers of a counter (float64)."""
    nodes = Nodes()
    m = Numpy(nodes)

    def given(name: str, level: int) -> Value:
        """Return an input of the graph."""
        return Value(nodes, nodes.intern_input(name, level, "uint64"))

    run = given("run", LANES)
    key = given("key", STEADY)
    low = run & philox.LOW
    high = run >> philox.HALF
    words = philox.philox(given("counter", SHARED), given("word", SHARED), low, high, key, m)
    numbers = [*philox.box_muller(words[0], words[1], m), *philox.box_muller(words[2], words[3], m)]
    return [m.float64(number).node for number in numbers]


def _print_row_start(text: Text, counter: str, i: int, last: str, row: str) -> tuple[str, str]:
    """Print whether the i-th step of a counter is requested and the index of its first number, and
    return both.
    """
    k = text.add(f"add i64 {text.add(f'mul i64 {counter}, 4')}, {i}")
    late = text.add(f"icmp ule i64 %first, {k}")
    early = text.add(f"icmp ult i64 {k}, {last}")
    is_due = text.add(f"and i1 {late}, {early}")
    return is_due, text.add(f"mul i64 {text.add(f'sub i64 {k}, %first')}, {row}")


def _run_source(text: Text, have: dict[Node, str], count: str) -> Names:
    """Return the source of names for the run numbers and for values shared by all lanes."""

    def source(node: Node) -> str:
        """Return the name of a value."""
        if node.level == LANES:
            return text.load(text.address_of("%runs", count), "i64", vector=True)
        return text.splat(have[node], TYPES[node.kind])

    return source
