"""Standard normal numbers for many runs at once, a run to a lane.

They are the bits of `noise.gaussian` and `noise.coloured`.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Final

import numpy as np

from undeadzone.compile import cache, philox
from undeadzone.compile.graph import LANES, SHARED, STEADY, Node, Nodes, used
from undeadzone.compile.machine import here
from undeadzone.compile.print_llvm import TYPES, Text, in_lanes, once
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


@functools.cache
def _fill() -> tuple[str, tuple[str, ...]]:
    """Text and arguments of what draws: of 32 bits a vector holds twice as many numbers."""
    return fill_text(2 * here().vector[0]), FILL


@functools.cache
def _colour() -> tuple[str, tuple[str, ...]]:
    """Text and arguments of what colours."""
    return colour_text(here().vector[0]), COLOUR


# Of the arguments of `fill`: steps, channels, lanes, numbers, first, key, words, runs.
FILL: Final = (*["int64"] * 3, "float64*", "int64", "uint64", "uint32*", "uint64*")
# Of those of `colour`: steps, channels, coloured, lanes, numbers, state, first, start, memory,
# drive.
COLOUR: Final = (*["int64"] * 4, *["float64*"] * 2, *["int64"] * 2, *["float64"] * 2)

_FILL: Final = """
define void @block(i64 %steps, i64 %channels, i64 %lanes, ptr noalias %numbers, i64 %first,
                   i64 %key, ptr noalias %words, ptr noalias %runs) nounwind {{
entry:
  %last = add i64 %first, %steps
  %first_four = udiv i64 %first, 4
  %rounded = add i64 %last, 3
  %last_four = udiv i64 %rounded, 4
  %row = mul i64 %channels, %lanes
  %whole = and i64 %lanes, -{group}
  br label %four
four:
  %counter = phi i64 [%first_four, %entry], [%counter_next, %four_end]
  %counter_next = add i64 %counter, 1
  %more = icmp ult i64 %counter, %last_four
  br i1 %more, label %steps_of, label %end
steps_of:
  %k0 = mul i64 %counter, 4
{rows}
  br label %channel
channel:
  %c = phi i64 [0, %steps_of], [%c_next, %channel_end]
  %c_next = add i64 %c, 1
  %some = icmp ult i64 %c, %channels
  br i1 %some, label %channel_do, label %four_end
channel_do:
  %word_at = getelementptr i32, ptr %words, i64 %c
  %word_short = load i32, ptr %word_at
  %word = zext i32 %word_short to i64
  %start = mul i64 %c, %lanes
  %any = icmp ult i64 0, %whole
{shared}
  br i1 %any, label %many, label %few_if
{many}
few_if:
  %left = icmp ult i64 %whole, %lanes
  br i1 %left, label %few, label %channel_end
{few}
channel_end:
  br label %channel
four_end:
  br label %four
end:
  ret void
}}
{declared}
"""

# A loop over groups of lanes: where a step is asked for, its numbers are stored.
_GROUPS: Final = """{name}:
  %j_{name} = phi i64 [{begin}, {came}], [%j_{name}_next, %{name}_end]
  %j_{name}_next = add i64 %j_{name}, {group}
  %run_{name} = getelementptr i64, ptr %runs, i64 %j_{name}
  %at_{name} = add i64 %start, %j_{name}
{body}
  br label %{name}_0
{stores}
{name}_end:
  %go_{name} = icmp ult i64 %j_{name}_next, {end}
  br i1 %go_{name}, label %{name}, label %{then}"""

_STORE: Final = """{name}_{i}:
  br i1 %asked{i}, label %{name}_do{i}, label %{name}_{following}
{name}_do{i}:
  %place_{name}{i} = add i64 %row{i}, %at_{name}
  %to_{name}{i} = getelementptr double, ptr %numbers, i64 %place_{name}{i}
  store {vector} {value}, ptr %to_{name}{i}, align 8
  br label %{name}_{following}"""

_ROW: Final = """  %k_{i} = add i64 %k0, {i}
  %late{i} = icmp ule i64 %first, %k_{i}
  %early{i} = icmp ult i64 %k_{i}, %last
  %asked{i} = and i1 %late{i}, %early{i}
  %from{i} = sub i64 %k_{i}, %first
  %row{i} = mul i64 %from{i}, %row"""

_COLOUR: Final = """
define void @block(i64 %steps, i64 %channels, i64 %coloured, i64 %lanes, ptr noalias %numbers,
                   ptr noalias %state, i64 %first, i64 %start, double %memory, double %drive)
                   nounwind {{
entry:
  %memories = insertelement <{group} x double> poison, double %memory, i64 0
  %m = shufflevector <{group} x double> %memories, <{group} x double> poison, {zeros}
  %drives = insertelement <{group} x double> poison, double %drive, i64 0
  %d = shufflevector <{group} x double> %drives, <{group} x double> poison, {zeros}
  %row = mul i64 %channels, %lanes
  %whole = and i64 %lanes, -{group}
  %none = icmp slt i64 %steps, 1
  br i1 %none, label %end, label %channel
channel:
  %c = phi i64 [0, %entry], [%c_next, %channel_end]
  %c_next = add i64 %c, 1
  %some = icmp ult i64 %c, %coloured
  br i1 %some, label %channel_do, label %end
channel_do:
  %c_state = mul i64 %c, %lanes
  %c_number = add i64 %c, %start
  %at = mul i64 %c_number, %lanes
  %any = icmp ult i64 0, %whole
  br i1 %any, label %many, label %few_if
{many}
few_if:
  %left = icmp ult i64 %whole, %lanes
  br i1 %left, label %few, label %channel_end
{few}
channel_end:
  br label %channel
end:
  ret void
}}
"""

# A loop over groups, and inside it over steps: the very first number stays as it is.
_COLOURED: Final = """{name}:
  %j_{name} = phi i64 [{begin}, {came}], [%j_{name}_next, %{name}_end]
  %j_{name}_next = add i64 %j_{name}, {group}
  %s_{name} = add i64 %c_state, %j_{name}
  %state_{name} = getelementptr double, ptr %state, i64 %s_{name}
  %before_{name} = load {vector}, ptr %state_{name}, align 8
  br label %{name}_step
{name}_step:
  %k_{name} = phi i64 [0, %{name}], [%k_{name}_next, %{name}_step]
  %last_{name} = phi {vector} [%before_{name}, %{name}], [%new_{name}, %{name}_step]
  %k_{name}_next = add i64 %k_{name}, 1
  %r_{name} = mul i64 %k_{name}, %row
  %a_{name} = add i64 %r_{name}, %at
  %b_{name} = add i64 %a_{name}, %j_{name}
  %to_{name} = getelementptr double, ptr %numbers, i64 %b_{name}
  %white_{name} = load {vector}, ptr %to_{name}, align 8
  %x_{name} = fmul {vector} {memory}, %last_{name}
  %y_{name} = fmul {vector} {drive}, %white_{name}
  %z_{name} = fadd {vector} %x_{name}, %y_{name}
  %n_{name} = add i64 %first, %k_{name}
  %later_{name} = icmp sgt i64 %n_{name}, 0
  %new_{name} = select i1 %later_{name}, {vector} %z_{name}, {vector} %white_{name}
  store {vector} %new_{name}, ptr %to_{name}, align 8
  %again_{name} = icmp ult i64 %k_{name}_next, %steps
  br i1 %again_{name}, label %{name}_step, label %{name}_end
{name}_end:
  store {vector} %new_{name}, ptr %state_{name}, align 8
  %go_{name} = icmp ult i64 %j_{name}_next, {end}
  br i1 %go_{name}, label %{name}, label %{then}"""


def fill_text(group: int) -> str:
    """The text of what fills an array with normal numbers, a group of runs at a time."""
    nodes = Nodes()
    m = Numpy(nodes)

    def given(name: str, level: int) -> Value:
        return Value(nodes, nodes.input(name, level, "uint64"))

    run, key = given("run", LANES), given("key", STEADY)
    low, high = run & philox.LOW, run >> philox.HALF
    words = philox.philox(given("counter", SHARED), given("word", SHARED), low, high, key, m)
    numbers = [*philox.box_muller(words[0], words[1], m), *philox.box_muller(words[2], words[3], m)]
    results = [m.float64(number).node for number in numbers]
    declared: dict[str, str] = {}
    shared, have = Text(1, declared, "once"), dict[Node, str]()
    order = of_graph(results)
    below = [*used(order, results, STEADY), *used(order, results, SHARED)]
    once(shared, below, have, lambda node: f"%{node.text}")
    loops = [
        _groups("many", group, results, have, declared),
        _groups("few", 1, results, have, declared),
    ]
    return _FILL.format(
        group=group,
        rows="\n".join([_ROW.format(i=i) for i in range(4)]),
        shared="\n".join(shared.lines),
        many=loops[0],
        few=loops[1],
        declared="\n".join(declared.values()),
    )


def _groups(
    name: str, group: int, results: list[Node], have: dict[Node, str], declared: dict[str, str]
) -> str:
    """The loop over whole groups, or over the runs that are left."""
    text = Text(group, declared, name)

    def source(node: Node) -> str:
        if node.level == LANES:
            return text.load(f"%run_{name}", "i64", vector=True)
        return text.splat(have[node], TYPES[node.kind])

    (names,) = in_lanes(text, of_graph(results), [source], False)
    stores = []
    for i, node in enumerate(results):
        following = f"{i + 1}" if i < 3 else "end"
        store = {"name": name, "i": i, "following": following, "value": names(node)}
        stores.append(_STORE.format(**store, vector=text.type("double")))
    return _GROUPS.format(
        **_loop(name, group), body="\n".join(text.lines), stores="\n".join(stores)
    )


def _loop(name: str, group: int) -> dict[str, object]:
    """Begin and end of a loop over groups, the whole ones first."""
    ends = {"many": ("0", "%channel_do", "%whole", "few_if")}
    begin, came, end, then = ends.get(name, ("%whole", "%few_if", "%lanes", "channel_end"))
    numbers = {"begin": begin, "came": came, "end": end, "then": then}
    return {"name": name, "group": group, **numbers}


def colour_text(group: int) -> str:
    """The text of what makes first-order noise of white noise, a group of runs at a time."""
    vector = f"<{group} x double>"
    many = {**_loop("many", group), "vector": vector, "memory": "%m", "drive": "%d"}
    few = {**_loop("few", 1), "vector": "double", "memory": "%memory", "drive": "%drive"}
    return _COLOUR.format(
        group=group,
        zeros=f"<{group} x i32> zeroinitializer",
        many=_COLOURED.format(**many),
        few=_COLOURED.format(**few),
    )
