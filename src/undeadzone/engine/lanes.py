"""Many runs at once: the graph compiled for this CPU, a run to a lane.

Time is outermost, `width` lanes innermost, threads go over blocks of lanes. A lane's numbers do not
depend on the other lanes, the width, the threads, or on which of its inputs are shared.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine import cache
from undeadzone.engine.kernel import KINDS, Shape, source, stride
from undeadzone.errors import InputError, ShapeError
from undeadzone.support.arrays import Floats, Integers, shape_text

WIDTH = 128
# Numbers of recorded outputs and lane inputs between two calls of a kernel: 1 MB stays in L2.
BUFFER = 2**17

LINE = 8  # numbers in a line of the cache
# (first step, steps), asked for in order -> steps x own inputs x lanes
Source = Callable[[int, int], Floats]
Supply = Callable[[Integers], Source]  # lane numbers -> their source


class Kernel(NamedTuple):
    """A compiled step for many lanes at a time.

    Attributes:
        block: block(steps, work, exogenous, params, own, outputs), of flat arrays, lanes last.
        shape: what it was compiled for.
        rows: of the work array, in the order of `kernel.Rows`.
    """

    block: Any
    shape: Shape
    rows: int


class _Inputs(NamedTuple):
    """What a run is given, checked.

    Attributes:
        states: at the beginning (lanes x states).
        exogenous: w of each step (N x inputs).
        params: p.
        own_params: entries of p that differ by lane (lanes x own params).
        supply: of the entries of w that differ by lane.
    """

    states: Floats
    exogenous: Floats
    params: Floats
    own_params: Floats
    supply: Supply


class _Schedule(NamedTuple):
    """When a run keeps and reports.

    Attributes:
        every: the outputs of each so many-th step are kept.
        chunk: steps of one call of the kernel, a multiple of `every`.
        progress: told of lanes x steps done.
    """

    every: int
    chunk: int
    progress: Callable[[int], None] | None


def build(
    step: ca.Function,
    rare: Sequence[ca.Function] = (),
    *,
    exogenous: Sequence[int] = (),
    params: Sequence[int] = (),
    record: Sequence[int] | None = None,
    known_exogenous: Mapping[int, float] = MappingProxyType({}),
    known_params: Mapping[int, float] = MappingProxyType({}),
    width: int = WIDTH,
    fused: bool = False,
) -> Kernel:
    """Compile a step, or take it from disk if it was compiled before.

    Args:
        step: next, out = step(s, w, p); with rare parts next, out, flag = step(s, w, p).
        rare: where flag is not 0, the first entries of next and a new flag are rare[0](s, w, p),
            and so on, the last flag being without meaning.
        exogenous, params: entries of w and p that differ from lane to lane.
        record: entries of out to keep; default: all.
        known_exogenous, known_params: entries that have these values throughout (0 and 1 make the
            kernel shorter).
        width: lanes; 1 for a single run, a multiple of 16 (below that LLVM unrolls into scalar
            code) for many.
        fused: multiply and add with one rounding: faster, within rounding of CasADi's virtual
            machine where otherwise every bit agrees.

    Raises:
        InputError: an entry that is not there, or an instruction that cannot be compiled.
    """
    sizes = (step.size1_in(0), step.size1_in(1), step.size1_in(2))
    outputs = step.size1_out(1)
    recorded = range(outputs) if record is None else record
    _require_entries("exogenous", [*exogenous, *known_exogenous], sizes[1])
    _require_entries("params", [*params, *known_params], sizes[2])
    _require_entries("record", recorded, outputs)
    shape = Shape(width, sizes, tuple(exogenous), tuple(params), tuple(recorded))
    text, rows = source(step, rare, shape, known_exogenous, known_params, fused)
    return Kernel(cache.load(text, KINDS), shape, rows)


def run(
    kernel: Kernel,
    states: Floats,
    exogenous: Floats,
    params: Floats,
    lane_exogenous: Floats | Supply | None = None,
    lane_params: Floats | None = None,
    *,
    every: int = 1,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[Floats, Floats]:
    """Run the kernel's step along N steps in every lane.

    Args:
        kernel: the compiled step.
        states: at the beginning, (states) or (lanes x states).
        exogenous: w of each step (N x inputs).
        params: p.
        lane_exogenous: replaces the entries of w that differ by lane (N x own inputs x lanes), or
            what supplies it, from several threads.
        lane_params: replaces the entries of p that differ by lane (lanes x own params).
        every: keep the outputs of each so many-th step, the first included.
        threads: default one per processor.
        progress: told of lanes x steps done, from any thread.

    Returns:
        The outputs (lanes x kept steps x recorded) and the final states (lanes x states).

    Raises:
        ShapeError: an array of another shape.
    """
    shape = kernel.shape
    inputs = _checked(shape, states, exogenous, params, lane_exogenous, lane_params)
    total, lanes = len(inputs.exogenous), len(inputs.states)
    outputs = np.empty((lanes, -(-total // every), len(shape.record)))
    finals = np.empty((lanes, shape.sizes[0]))
    schedule = _Schedule(every, _chunk(shape, every), progress)
    run_block = partial(_run_block, kernel, inputs, schedule, outputs, finals)
    starts = range(0, lanes, shape.width)
    if len(starts) == 1:
        run_block(0)  # a pool of threads would cost more than a short run
        return outputs, finals
    with ThreadPoolExecutor(min(threads or os.cpu_count() or 1, len(starts))) as pool:
        # A failure or Ctrl-C here drops the blocks that have not begun.
        for _ in pool.map(run_block, starts):
            pass
    return outputs, finals


def _require_entries(name: str, entries: Sequence[int], size: int) -> None:
    """Raise InputError for an entry that is not there."""
    for index in entries:
        if not 0 <= index < size:
            raise InputError(f"{name}: expected entries from 0 to {size - 1}, found {index}")


def _checked(
    shape: Shape,
    states: Floats,
    exogenous: Floats,
    params: Floats,
    lane_exogenous: Floats | Supply | None,
    lane_params: Floats | None,
) -> _Inputs:
    """The arguments of `run` in the shapes of a kernel. Raises ShapeError."""
    own = None if callable(lane_exogenous) else lane_exogenous
    lanes = _lanes(
        ("states", states, 2, 0),
        ("lane_exogenous", own, 3, 2),
        ("lane_params", lane_params, 2, 0),
    )
    total = len(exogenous)
    states_each, entries_w, entries_p = shape.sizes
    expected = (lanes, states_each) if np.ndim(states) > 1 else (states_each,)
    states = np.broadcast_to(_shaped("states", states, *expected), (lanes, states_each))
    exogenous = np.array(_shaped("exogenous", exogenous, total, entries_w), order="C")
    params = np.array(_shaped("params", params, entries_p), order="C")
    if lane_params is None:
        lane_params = np.empty((lanes, 0))
    own_params = _shaped("lane_params", lane_params, lanes, len(shape.params))
    if callable(lane_exogenous):
        return _Inputs(states, exogenous, params, own_params, lane_exogenous)
    if own is None:
        own = np.empty((total, 0, lanes))
    own = _shaped("lane_exogenous", own, total, len(shape.exogenous), lanes)
    return _Inputs(states, exogenous, params, own_params, _held(own))


def _chunk(shape: Shape, every: int) -> int:
    """The steps of one call of a kernel: a multiple of `every`, and of 4 for the noise."""
    unit = math.lcm(4, every)
    numbers = shape.width * max(1, len(shape.record), len(shape.exogenous))  # of a step
    return max(1, BUFFER // numbers // unit) * unit


def _run_block(
    kernel: Kernel,
    inputs: _Inputs,
    schedule: _Schedule,
    outputs: Floats,
    finals: Floats,
    start: int,
) -> None:
    """Run the lanes from `start` on that fit into a kernel; their results are written in place."""
    shape, every = kernel.shape, schedule.every
    states_each, width = shape.sizes[0], shape.width
    total, lanes = len(inputs.exogenous), len(inputs.states)
    end = min(start + width, lanes)
    # Places beyond the last lane repeat it.
    spread = np.minimum(np.arange(start, start + width), lanes - 1)
    work = _aligned(kernel.rows, stride(width))
    work[:states_each, :width] = inputs.states[spread].T
    work[states_each : states_each + len(shape.params), :width] = inputs.own_params[spread].T
    own = inputs.supply(spread)
    buffer = np.empty((min(schedule.chunk, total), len(shape.record), width))
    for first in range(0, total, schedule.chunk):
        count = min(schedule.chunk, total - first)
        kernel.block(
            count,
            work.reshape(-1),
            inputs.exogenous[first : first + count].ravel(),
            inputs.params,
            own(first, count).ravel(),
            buffer.reshape(-1),
        )
        kept = buffer[:count:every, :, : end - start].transpose(2, 0, 1)
        at = first // every
        outputs[start:end, at : at + kept.shape[1]] = kept
        if schedule.progress is not None:
            schedule.progress(count * (end - start))
    finals[start:end] = work[:states_each, : end - start].T


def _aligned(rows: int, columns: int) -> Floats:
    """Zeros from where a line of the cache begins: no vector of a row lies across two lines."""
    raw = np.zeros(rows * columns + LINE)
    start = -(raw.ctypes.data // raw.itemsize) % LINE
    return raw[start : start + rows * columns].reshape(rows, columns)


def _held(inputs: Floats) -> Supply:
    """A supply from an array (N x own inputs x lanes)."""

    def of_lanes(lanes: Integers) -> Source:
        return partial(_steps_of_lanes, inputs, lanes)

    return of_lanes


def _steps_of_lanes(inputs: Floats, lanes: Integers, first: int, count: int) -> Floats:
    """Some steps of some lanes of an array (N x own inputs x lanes)."""
    return inputs[first : first + count, :, lanes]


def _lanes(*sources: tuple[str, Any, int, int]) -> int:
    """The number of lanes that arrays agree on.

    Args:
        sources: name, value, dimensions when it has lanes, axis of lanes.
    """
    counts = {}
    for name, value, dimensions, axis in sources:
        if np.ndim(value) == dimensions:
            counts[name] = np.shape(value)[axis]
    if len(set(counts.values())) > 1 or 0 in counts.values():
        listed = ", ".join(f"{count} in {name}" for name, count in counts.items())
        raise ShapeError(f"lanes: expected one number of lanes, 1 or more, found {listed}")
    return next(iter(counts.values()), 1)


def _shaped(name: str, value: Floats, *shape: int) -> Floats:
    """An array of a given shape. Raises ShapeError for another one."""
    numbers = np.asarray(value, float)
    if numbers.shape != shape:
        present = shape_text(numbers.shape) or "one number"
        raise ShapeError(f"{name}: expected {shape_text(shape)}, found {present}")
    return numbers
