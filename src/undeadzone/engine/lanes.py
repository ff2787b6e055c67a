"""Many runs at once: the graph compiled for this CPU, time outermost, `width` lanes innermost, threads over blocks of lanes.

A lane's numbers do not depend on the other lanes, the width, the threads, or on which of its inputs are shared.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.arrays import Floats, Integers
from undeadzone.engine import cache
from undeadzone.engine.emit import HELPERS, Code, straight_line
from undeadzone.errors import InputError, ShapeError

WIDTH = 128
GROUP = 8  # lanes whose rare part is computed together
BUFFER = 2**17  # numbers of recorded outputs and lane inputs between two calls of a kernel: 1 MB, which stays in L2

Source = Callable[[int, int], Floats]  # (first step, steps), asked for in order -> steps x own inputs x lanes
Supply = Callable[[Integers], Source]  # lane numbers -> their source


class Kernel(NamedTuple):
    """A compiled step for `width` lanes at a time.

    exogenous, params: indices of the inputs that each lane has for itself; record: outputs that are kept; rows: of the
    work array, in the order of `_Rows`;
    block(steps, work, exogenous, params, own, outputs): flat arrays, lanes last.
    """

    block: Any
    width: int
    sizes: tuple[int, int, int]
    exogenous: tuple[int, ...]
    params: tuple[int, ...]
    record: tuple[int, ...]
    rows: int


class _Rows(NamedTuple):
    """The first row of each part of a kernel's work array: states, own params, own inputs, outputs, states before the step, flag.

    A lane's numbers stand in one array at constant distances: LLVM need not ask whether they overlap, and vectorises
    whatever their number.
    """

    width: int
    params: int
    own: int
    out: int
    before: int
    flag: int

    def at(self, row: int) -> str:
        return f"work[{row * stride(self.width)} + j]"


def stride(width: int) -> int:
    """The numbers of a row of a work array: rows whose distance is no power of 2 share no set of the cache."""
    return width + 8 if width > 1 else 1


def build(
    step: ca.Function,
    rare: ca.Function | None = None,
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

    rare: with it, next, out, flag = step(s, w, p), and where flag is not 0 the first entries of next are rare(s, w, p);
    exogenous, params: entries of w and p that differ from lane to lane; record: entries of out to keep (default: all);
    known_exogenous, known_params: entries that have these values throughout (0 and 1 make the kernel shorter);
    width: 1 for a single run, a multiple of 16 (below that LLVM unrolls
    into scalar code) for many; fused: multiply and add with one rounding: faster, within rounding of CasADi's virtual
    machine where otherwise every bit agrees. Raises InputError for an entry that is not there and an instruction that
    cannot be compiled.
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
    kernel = Kernel(None, width, sizes, tuple(exogenous), tuple(params), tuple(recorded), 0)
    text, rows = source(step, rare, kernel, known_exogenous, known_params, fused)
    return kernel._replace(block=cache.load(text), rows=rows)


def source(step: ca.Function, rare: ca.Function | None, kernel: Kernel, w: Mapping[int, float], p: Mapping[int, float], fused: bool) -> tuple[str, int]:
    """(the text of the kernel, the rows of its work array), w and p being what is known of its inputs."""
    columns = [ca.SX.sym(name, size) for name, size in zip("swp", kernel.sizes, strict=True)]
    given = [columns[0], *(ca.vertcat(*(known.get(i, column[i]) for i in range(column.numel()))) for column, known in zip(columns[1:], (w, p), strict=True))]
    following, out, *flag = (ca.densify(ca.SX(value)) for value in step(*given))
    usual = straight_line(_graph(columns, [following, out[list(kernel.record)], *flag]), fused)
    finish = None if rare is None else straight_line(_graph(columns, [ca.densify(ca.SX(rare(*given)))]), fused)
    saved = 0 if finish is None else 1 + max(finish.reads[0], default=-1)
    starts = list(itertools.accumulate((kernel.sizes[0], len(kernel.params), len(kernel.exogenous), len(kernel.record), saved)))
    rows = _Rows(kernel.width, *starts)
    lane = [
        *_inputs(usual, kernel, rows, 0),
        *usual.statements,
        *(f"{rows.at(rows.before + i)} = {rows.at(i)}" for i in range(saved)),
        *(f"{rows.at(i)} = {name}" for i, name in enumerate(usual.results[0])),
        *(f"{rows.at(rows.out + i)} = {name}" for i, name in enumerate(usual.results[1])),
    ]
    loop = [*_shared(usual, kernel), *_copied(kernel, rows.own, "own", len(kernel.exogenous)), f"for j in range({kernel.width}):"]
    head = ["def block(steps, work, exogenous, params, own, outputs):", *_indented(_steady(usual, kernel))]
    signature = f'@njit("void(int64, {", ".join(["float64[::1]"] * 5)})", error_model="numpy", nogil=True, cache="__file__" in globals())'
    helper: list[str] = []
    if finish is None:
        loop += _indented(lane)
    else:
        group, apart = min(kernel.width, GROUP), stride(kernel.width)
        helper = [
            '@njit(error_model="numpy", nogil=True)',
            "def rare(k, work, exogenous, params):",
            *_indented([*_steady(finish, kernel), *_shared(finish, kernel), f"for j in range({group}):"]),
            *_indented([*_inputs(finish, kernel, rows, rows.before), *finish.statements], 2),
            *_indented([f"{rows.at(i)} = {name}" for i, name in enumerate(finish.results[0])], 2),
            "",
            '@njit(error_model="numpy", nogil=True)',
            "def finish(k, work, few, chosen, count, exogenous, params):",
            f"    for first in range(0, count, {group}):",
            f"        some = chosen[first : min(first + {group}, count)]",
            f"        for row in range({rows.params}, {rows.flag}):",
            "            for m in range(some.size):",
            f"                few[row * {apart} + m] = work[row * {apart} + some[m]]",
            "        rare(k, few, exogenous, params)",
            f"        for row in range({len(finish.results[0])}):",
            "            for m in range(some.size):",
            f"                work[row * {apart} + some[m]] = few[row * {apart} + m]",
        ]
        head += _indented(["few = np.zeros_like(work)", f"chosen = np.zeros({kernel.width}, np.int64)"])
        loop += [
            *_indented([*lane, f"{rows.at(rows.flag)} = {usual.results[2][0]}"]),
            "count = 0",
            f"for j in range({kernel.width}):",
            f"    count += {rows.at(rows.flag)} != 0.0",
            "if count:",
            "    count = 0",
            f"    for j in range({kernel.width}):",
            "        chosen[count] = j",
            f"        count += {rows.at(rows.flag)} != 0.0",
            "    finish(k, work, few, chosen, count, exogenous, params)",
        ]
    loop += _copied(kernel, rows.out, "outputs", len(kernel.record))
    return "\n".join([HELPERS, *helper, signature, *head, "    for k in range(steps):", *_indented(loop, 2)]), rows.flag + (rare is not None)


def _steady(code: Code, kernel: Kernel) -> list[str]:
    """The params that all lanes share."""
    return [f"p{i} = params[{i}]" for i in code.reads[2] if i not in kernel.params]


def _shared(code: Code, kernel: Kernel) -> list[str]:
    """The exogenous inputs of step k that all lanes share."""
    return [f"w{i} = exogenous[k * {kernel.sizes[1]} + {i}]" for i in code.reads[1] if i not in kernel.exogenous]


def _inputs(code: Code, kernel: Kernel, rows: _Rows, states: int) -> list[str]:
    """What lane j reads, its state from row `states` on."""
    s, w, p = code.reads
    return [
        *(f"s{i} = {rows.at(states + i)}" for i in s),
        *(f"w{i} = {rows.at(rows.own + kernel.exogenous.index(i))}" for i in w if i in kernel.exogenous),
        *(f"p{i} = {rows.at(rows.params + kernel.params.index(i))}" for i in p if i in kernel.params),
    ]


def _copied(kernel: Kernel, row: int, array: str, count: int) -> list[str]:
    """Rows from `row` on filled from, or copied to, the part of step k of an array.

    Of indices into a part, unlike those that k multiplies, LLVM knows the sign, and so vectorises.
    """
    inside, outside = f"work[({row} + i) * {stride(kernel.width)} + j]", f"part[i * {kernel.width} + j]"
    size = count * kernel.width
    return [
        f"part = {array}[k * {size} : (k + 1) * {size}]",
        f"for i in range({count}):",
        f"    for j in range({kernel.width}):",
        f"        {f'{inside} = {outside}' if array == 'own' else f'{outside} = {inside}'}",
    ] * bool(count)


def _graph(columns: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function("graph", columns, results, ["s", "w", "p"], [f"result{i}" for i in range(len(results))])


def _indented(lines: list[str], depth: int = 1) -> list[str]:
    return [f"{'    ' * depth}{line}" for line in lines]


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
    kernel.exogenous x lanes), or what supplies it, from several threads; lane_params: (lanes x kernel.params). Both
    replace the entries that differ by lane. every: keep the outputs of each so many-th step, the first included;
    threads: default one per processor; progress: told of lanes x steps done, from any thread.
    Raises ShapeError.
    """
    given = None if callable(lane_exogenous) else lane_exogenous
    lanes = _lanes(("states", states, 2, 0), ("lane_exogenous", given, 3, 2), ("lane_params", lane_params, 2, 0))
    total = len(exogenous)
    states_each, inputs, numbers = kernel.sizes
    states = np.broadcast_to(_shaped("states", states, *((lanes, states_each) if np.ndim(states) > 1 else (states_each,))), (lanes, states_each))
    exogenous = np.array(_shaped("exogenous", exogenous, total, inputs), order="C")
    params = np.array(_shaped("params", params, numbers), order="C")
    own_params = _shaped("lane_params", np.empty((lanes, 0)) if lane_params is None else lane_params, lanes, len(kernel.params))
    own_inputs = np.empty((total, 0, lanes)) if given is None else given
    supply = lane_exogenous if callable(lane_exogenous) else _held(_shaped("lane_exogenous", own_inputs, total, len(kernel.exogenous), lanes))
    outputs, finals = np.empty((lanes, -(-total // every), len(kernel.record))), np.empty((lanes, states_each))
    unit = math.lcm(4, every)
    chunk = max(1, BUFFER // (kernel.width * max(1, len(kernel.record), len(kernel.exogenous))) // unit) * unit

    def block(start: int) -> None:
        end = min(start + kernel.width, lanes)
        spread = np.minimum(np.arange(start, start + kernel.width), lanes - 1)  # places beyond the last lane repeat it
        work = _aligned(kernel.rows, stride(kernel.width))
        work[:states_each, : kernel.width] = states[spread].T
        work[states_each : states_each + len(kernel.params), : kernel.width] = own_params[spread].T
        source = supply(spread)
        buffer = np.empty((min(chunk, total), len(kernel.record), kernel.width))
        for first in range(0, total, chunk):
            count = min(chunk, total - first)
            kernel.block(count, work.reshape(-1), exogenous[first : first + count].ravel(), params, source(first, count).ravel(), buffer.reshape(-1))
            outputs[start:end, first // every : first // every - (-count // every)] = buffer[:count:every, :, : end - start].transpose(2, 0, 1)
            if progress is not None:
                progress(count * (end - start))
        finals[start:end] = work[:states_each, : end - start].T

    starts = range(0, lanes, kernel.width)
    with ThreadPoolExecutor(min(threads or os.cpu_count() or 1, len(starts))) as pool:
        for _ in pool.map(block, starts):  # a failure or Ctrl-C here drops the blocks that have not begun
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
    counts = {name: np.shape(value)[axis] for name, value, dimensions, axis in sources if np.ndim(value) == dimensions}
    if len(set(counts.values())) > 1 or 0 in counts.values():
        raise ShapeError(f"lanes: expected one number of lanes, 1 or more, found {', '.join(f'{count} in {name}' for name, count in counts.items())}")
    return next(iter(counts.values()), 1)


def _shaped(name: str, value: Floats, *shape: int) -> Floats:
    found = np.asarray(value, float)
    if found.shape != shape:
        raise ShapeError(f"{name}: expected {' x '.join(map(str, shape))}, found {' x '.join(map(str, found.shape)) or 'one number'}")
    return found
