"""Many runs at once: the graph compiled for this CPU, time outermost, `width` lanes innermost, threads over blocks of lanes.

A lane's numbers do not depend on the other lanes, the width, the threads, or on which of its inputs are shared.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.arrays import Floats
from undeadzone.engine import cache
from undeadzone.engine.emit import HELPERS, straight_line
from undeadzone.errors import InputError, ShapeError

WIDTH = 128
BUFFER = 2**17  # numbers of recorded outputs and lane inputs between two calls of a kernel: 1 MB, which stays in L2


class Kernel(NamedTuple):
    """A compiled step for `width` lanes at a time.

    exogenous, params: indices of the inputs that each lane has for itself; record: outputs that are kept;
    block(steps, states, exogenous, lane_exogenous, params, lane_params, outputs): flat arrays, lanes last.
    """

    block: Any
    width: int
    sizes: tuple[int, int, int]
    exogenous: tuple[int, ...]
    params: tuple[int, ...]
    record: tuple[int, ...]


def build(
    step: ca.Function,
    *,
    exogenous: Sequence[int] = (),
    params: Sequence[int] = (),
    record: Sequence[int] | None = None,
    width: int = WIDTH,
    fused: bool = False,
) -> Kernel:
    """Compile next, out = step(s, w, p), or take it from disk if it was compiled before.

    exogenous, params: entries of w and p that differ from lane to lane; record: entries of out to keep (default: all);
    width: 1 for a single run, a multiple of 16 (below that LLVM unrolls into scalar code) for many;
    fused: multiply and add with one rounding: faster, within rounding of CasADi's virtual machine where otherwise every
    bit agrees. Raises InputError for an entry that is not there and an instruction that cannot be compiled.
    """
    sizes = (step.size1_in(0), step.size1_in(1), step.size1_in(2))
    recorded = range(step.size1_out(1)) if record is None else record
    for name, chosen, size in (("exogenous", exogenous, sizes[1]), ("params", params, sizes[2]), ("record", recorded, step.size1_out(1))):
        if outside := [index for index in chosen if not 0 <= index < size]:
            raise InputError(f"{name}: expected entries from 0 to {size - 1}, found {outside[0]}")
    kernel = Kernel(None, width, sizes, tuple(exogenous), tuple(params), tuple(recorded))
    return kernel._replace(block=cache.load(_source(step, kernel, fused)))


def _source(step: ca.Function, kernel: Kernel, fused: bool) -> str:
    columns = [ca.SX.sym(name, size) for name, size in zip("swp", kernel.sizes, strict=True)]
    following, out = (ca.densify(ca.SX(value)) for value in step(*columns))
    graph = ca.Function("step", columns, [following, out[list(kernel.record)]], ["s", "w", "p"], ["next", "out"])
    (s, w, p), statements, (following, recorded) = straight_line(graph, fused)
    width, lane_w, lane_p = kernel.width, kernel.exogenous, kernel.params
    in_block = [f"p{i} = params[{i}]" for i in p if i not in lane_p]
    in_step = [
        *(f"w{i} = exogenous[k * {kernel.sizes[1]} + {i}]" for i in w if i not in lane_w),
        _row("own", "lane_exogenous", len(lane_w) * width),
        _row("out", "outputs", len(recorded) * width),
    ]
    in_lane = [
        *(f"s{i} = states[{i * width} + j]" for i in s),
        *(f"w{i} = own[{lane_w.index(i) * width} + j]" for i in w if i in lane_w),
        *(f"p{i} = lane_params[{lane_p.index(i) * width} + j]" for i in p if i in lane_p),
        *statements,
        *(f"states[{i * width} + j] = {name}" for i, name in enumerate(following)),
        *(f"out[{i * width} + j] = {name}" for i, name in enumerate(recorded)),
    ]
    return "\n".join(
        [
            HELPERS,
            f'@njit("void(int64, {", ".join(["float64[::1]"] * 6)})", error_model="numpy", nogil=True, cache="__file__" in globals())',
            "def block(steps, states, exogenous, lane_exogenous, params, lane_params, outputs):",
            *(f"    {line}" for line in [*in_block, "for k in range(steps):"]),
            *(f"        {line}" for line in [*in_step, f"for j in range({width}):"]),
            *(f"            {line}" for line in in_lane),
        ]
    )


def _row(name: str, array: str, size: int) -> str:
    """The part of step k: of indices into it, unlike those that k multiplies, LLVM knows the sign, and so vectorises."""
    return f"{name} = {array}[k * {size} : (k + 1) * {size}]"


def run(
    kernel: Kernel,
    states: Floats,
    exogenous: Floats,
    params: Floats,
    lane_exogenous: Floats | None = None,
    lane_params: Floats | None = None,
    *,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[Floats, Floats]:
    """(outputs (lanes x N x recorded), final states (lanes x states)) of the kernel's step along N steps.

    states: (states) or (lanes x states); exogenous: (N x inputs); params: (params); lane_exogenous: (N x
    kernel.exogenous x lanes) and lane_params: (lanes x kernel.params) replace the entries that differ by lane.
    threads: default one per processor; progress: told of lanes x steps done, from any thread. Raises ShapeError.
    """
    lanes = _lanes(("states", states, 2, 0), ("lane_exogenous", lane_exogenous, 3, 2), ("lane_params", lane_params, 2, 0))
    total = len(exogenous)
    states_each, inputs, numbers = kernel.sizes
    states = np.broadcast_to(_shaped("states", states, *((lanes, states_each) if np.ndim(states) > 1 else (states_each,))), (lanes, states_each))
    exogenous = np.array(_shaped("exogenous", exogenous, total, inputs), order="C")
    params = np.array(_shaped("params", params, numbers), order="C")
    own_inputs = _shaped("lane_exogenous", np.empty((total, 0, lanes)) if lane_exogenous is None else lane_exogenous, total, len(kernel.exogenous), lanes)
    own_params = _shaped("lane_params", np.empty((lanes, 0)) if lane_params is None else lane_params, lanes, len(kernel.params))
    outputs, finals = np.empty((lanes, total, len(kernel.record))), np.empty((lanes, states_each))
    chunk = max(1, BUFFER // (kernel.width * max(1, len(kernel.record), len(kernel.exogenous))))

    def block(start: int) -> None:
        end = min(start + kernel.width, lanes)
        spread = np.minimum(np.arange(start, start + kernel.width), lanes - 1)  # places beyond the last lane repeat it
        s, p = states[spread].ravel(order="F"), own_params[spread].ravel(order="F")
        buffer = np.empty((min(chunk, total), len(kernel.record), kernel.width))
        for first in range(0, total, chunk):
            now = slice(first, min(first + chunk, total))
            count = now.stop - now.start
            kernel.block(count, s, exogenous[now].ravel(), own_inputs[now, :, spread].ravel(), params, p, buffer.reshape(-1))
            outputs[start:end, now] = buffer[:count, :, : end - start].transpose(2, 0, 1)
            if progress is not None:
                progress(count * (end - start))
        finals[start:end] = s.reshape(states_each, kernel.width).T[: end - start]

    starts = range(0, lanes, kernel.width)
    with ThreadPoolExecutor(min(threads or os.cpu_count() or 1, len(starts))) as pool:
        for _ in pool.map(block, starts):  # a failure or Ctrl-C here drops the blocks that have not begun
            pass
    return outputs, finals


def _lanes(*sources: tuple[str, Any, int, int]) -> int:
    """The number of lanes that arrays agree on, each given by name, value, dimensions when it has lanes, axis of lanes."""
    counts = {name: np.shape(value)[axis] for name, value, dimensions, axis in sources if np.ndim(value) == dimensions}
    if len(set(counts.values())) > 1 or 0 in counts.values():
        raise ShapeError(f"lanes: expected one number of lanes, 1 or more, found {', '.join(f'{count} in {name}' for name, count in counts.items())}")
    return next(iter(counts.values()), 1)


def _shaped(name: str, value: Floats, *shape: int) -> Floats:
    found = np.asarray(value, float)
    if found.shape != shape:
        raise ShapeError(f"{name}: expected {' x '.join(map(str, shape))}, found {' x '.join(map(str, found.shape)) or 'one number'}")
    return found
