"""Many runs at once: the graph compiled for this CPU, time outermost, `width` lanes innermost, threads over blocks of lanes.

A lane's numbers do not depend on the other lanes, the width, the threads, or on which of its inputs are shared.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.engine import cache
from undeadzone.engine.kernel import KINDS, Shape, source, stride
from undeadzone.errors import InputError, ShapeError
from undeadzone.support.arrays import Floats, Integers

WIDTH = 128
BUFFER = (
    2**17
)  # numbers of recorded outputs and lane inputs between two calls of a kernel: 1 MB, which stays in L2

Source = Callable[
    [int, int], Floats
]  # (first step, steps), asked for in order -> steps x own inputs x lanes
Supply = Callable[[Integers], Source]  # lane numbers -> their source


class Kernel(NamedTuple):
    """A compiled step for many lanes at a time; rows: of the work array, in the order of `kernel.Rows`.

    block(steps, work, exogenous, params, own, outputs): flat arrays, lanes last.
    """

    block: Any
    shape: Shape
    rows: int


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
    """Compile next, out = step(s, w, p), or take it from disk if it was compiled before.

    rare: with them, next, out, flag = step(s, w, p); where flag is not 0, the first entries of next and a new flag are
    rare[0](s, w, p), and so on, the last flag being without meaning;
    exogenous, params: entries of w and p that differ from lane to lane; record: entries of out to keep (default: all);
    known_exogenous, known_params: entries that have these values throughout (0 and 1 make the kernel shorter);
    width: 1 for a single run, a multiple of 16 (below that LLVM unrolls into scalar code) for many; fused: multiply and
    add with one rounding: faster, within rounding of CasADi's virtual machine where otherwise every bit agrees. Raises
    InputError for an entry that is not there and an instruction that cannot be compiled.
    """
    sizes = (step.size1_in(0), step.size1_in(1), step.size1_in(2))
    recorded = range(step.size1_out(1)) if record is None else record
    for name, chosen, size in (
        ("exogenous", [*exogenous, *known_exogenous], sizes[1]),
        ("params", [*params, *known_params], sizes[2]),
        ("record", recorded, step.size1_out(1)),
    ):
        if outside := [index for index in chosen if not 0 <= index < size]:
            raise InputError(f"{name}: expected entries from 0 to {size - 1}, found {outside[0]}")
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
    """(outputs (lanes x N x recorded), final states (lanes x states)) of the kernel's step along N steps.

    states: (states) or (lanes x states); exogenous: (N x inputs); params: (params); lane_exogenous: (N x
    own inputs x lanes), or what supplies it, from several threads; lane_params: (lanes x own params). Both
    replace the entries that differ by lane. every: keep the outputs of each so many-th step, the first included;
    threads: default one per processor; progress: told of lanes x steps done, from any thread.
    Raises ShapeError.
    """
    shape = kernel.shape
    given = None if callable(lane_exogenous) else lane_exogenous
    lanes = _lanes(
        ("states", states, 2, 0),
        ("lane_exogenous", given, 3, 2),
        ("lane_params", lane_params, 2, 0),
    )
    total = len(exogenous)
    states_each, inputs, numbers = shape.sizes
    states = np.broadcast_to(
        _shaped(
            "states", states, *((lanes, states_each) if np.ndim(states) > 1 else (states_each,))
        ),
        (lanes, states_each),
    )
    exogenous = np.array(_shaped("exogenous", exogenous, total, inputs), order="C")
    params = np.array(_shaped("params", params, numbers), order="C")
    own_params = _shaped(
        "lane_params",
        np.empty((lanes, 0)) if lane_params is None else lane_params,
        lanes,
        len(shape.params),
    )
    own_inputs = np.empty((total, 0, lanes)) if given is None else given
    supply = (
        lane_exogenous
        if callable(lane_exogenous)
        else _held(_shaped("lane_exogenous", own_inputs, total, len(shape.exogenous), lanes))
    )
    outputs, finals = (
        np.empty((lanes, -(-total // every), len(shape.record))),
        np.empty((lanes, states_each)),
    )
    unit = math.lcm(4, every)
    chunk = (
        max(1, BUFFER // (shape.width * max(1, len(shape.record), len(shape.exogenous))) // unit)
        * unit
    )

    def block(start: int) -> None:
        end = min(start + shape.width, lanes)
        spread = np.minimum(
            np.arange(start, start + shape.width), lanes - 1
        )  # places beyond the last lane repeat it
        work = _aligned(kernel.rows, stride(shape.width))
        work[:states_each, : shape.width] = states[spread].T
        work[states_each : states_each + len(shape.params), : shape.width] = own_params[spread].T
        source = supply(spread)
        buffer = np.empty((min(chunk, total), len(shape.record), shape.width))
        for first in range(0, total, chunk):
            count = min(chunk, total - first)
            kernel.block(
                count,
                work.reshape(-1),
                exogenous[first : first + count].ravel(),
                params,
                source(first, count).ravel(),
                buffer.reshape(-1),
            )
            outputs[start:end, first // every : first // every - (-count // every)] = buffer[
                :count:every, :, : end - start
            ].transpose(2, 0, 1)
            if progress is not None:
                progress(count * (end - start))
        finals[start:end] = work[:states_each, : end - start].T

    starts = range(0, lanes, shape.width)
    if len(starts) == 1:
        block(0)  # a pool of threads would cost more than a short run
    else:
        with ThreadPoolExecutor(min(threads or os.cpu_count() or 1, len(starts))) as pool:
            for _ in pool.map(
                block, starts
            ):  # a failure or Ctrl-C here drops the blocks that have not begun
                pass
    return outputs, finals


def _aligned(rows: int, columns: int) -> Floats:
    """Zeros from an address on at which a line of the cache begins: no vector of a row lies across two."""
    line = 8
    raw = np.zeros(rows * columns + line)
    start = -(raw.ctypes.data // raw.itemsize) % line
    return raw[start : start + rows * columns].reshape(rows, columns)


def _held(inputs: Floats) -> Supply:
    """A supply from an array (N x own inputs x lanes)."""
    return lambda lanes: lambda first, count: inputs[first : first + count, :, lanes]


def _lanes(*sources: tuple[str, Any, int, int]) -> int:
    """The number of lanes that arrays agree on, each given by name, value, dimensions when it has lanes, axis of lanes."""
    counts = {
        name: np.shape(value)[axis]
        for name, value, dimensions, axis in sources
        if np.ndim(value) == dimensions
    }
    if len(set(counts.values())) > 1 or 0 in counts.values():
        raise ShapeError(
            f"lanes: expected one number of lanes, 1 or more, found {', '.join(f'{count} in {name}' for name, count in counts.items())}"
        )
    return next(iter(counts.values()), 1)


def _shaped(name: str, value: Floats, *shape: int) -> Floats:
    found = np.asarray(value, float)
    if found.shape != shape:
        raise ShapeError(
            f"{name}: expected {' x '.join(map(str, shape))}, found {' x '.join(map(str, found.shape)) or 'one number'}"
        )
    return found
