"""Many runs at once: the graph compiled for this CPU, with a lane for each run.

Threads go over blocks of lanes, kernels over groups of a block, and in each over time. A lane's
numbers do not depend on the other lanes, the width, the threads, or on which of its inputs are
shared.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from undeadzone.compile import assumptions, cache
from undeadzone.compile.assumptions import KernelAssumption
from undeadzone.compile.kernel import KINDS, KernelGraphs, build_graphs, print_kernel
from undeadzone.compile.lower import Arithmetic
from undeadzone.compile.machine import Form, Shape, environment_form, host_machine
from undeadzone.errors import InputError, ShapeError
from undeadzone.util.arrays import Floats, Integers, describe_shape

WIDTH = 128
WIDE = 1024  # lanes of a block without records and inputs of its own
MEASURED = 4000  # instructions, at most, of a step and its rare parts whose form is measured
# Numbers of recorded outputs and lane inputs between two calls of a kernel: 1 MB stays in L2.
BUFFER = 2**17

UNRECORDED = 1 / 8  # weight of a step without records and inputs of its own
LINE = 8  # numbers in a line of the cache


class Kernel(NamedTuple):
    """Compiled step for many lanes at a time.

    Attributes:
        block: block(steps, lanes, work, exogenous, params, own, outputs), of flat arrays, lanes
            last.
        shape: sizes for which it was compiled.
        form: how lanes are computed, until a long run finds a faster one (`cache.Trial`).
        width: lanes of a block, at most.
        promises: its assumptions about params.
    """

    block: Any
    shape: Shape
    form: Form
    width: int
    promises: tuple[KernelAssumption, ...]


class _Schedule(NamedTuple):
    """Schedule by which a run stores outputs and reports progress.

    Attributes:
        every: the outputs of each so many-th step are stored.
        chunk: steps of one call of the kernel, a multiple of `every`.
        progress: called with the number of lanes x steps done.
    """

    every: int
    chunk: int
    progress: Callable[[int], None] | None


def build_kernel(
    step: ca.Function,
    rare: Sequence[ca.Function] = (),
    *,
    exogenous: Sequence[int] = (),
    params: Sequence[int] = (),
    record: Sequence[int] | None = None,
    known_exogenous: Mapping[int, float] = MappingProxyType({}),
    known_params: Mapping[int, float] = MappingProxyType({}),
    width: int | None = None,
    fused: bool = False,
    portable: bool = False,
    form: Form | None = None,
    fast_start: bool = True,
) -> Kernel:
    """Compile a step, or read the kernel from disk if it was compiled before.

    Args:
        step: next, out = step(s, w, p), or with rare parts next, out, flag = step(s, w, p).
        rare: where flag is not 0, the first entries of next and a new flag are rare[0](s, w, p),
            and so on, the last flag being without meaning.
        exogenous, params: entries of w and p that differ from lane to lane.
        record: entries of out to keep (default: all).
        known_exogenous, known_params: entries that have these values throughout (0 and 1 make the
            kernel shorter).
        width: lanes of a block, at most, 1 for a single run, without vectors (default: as suits
            caches).
        fused: multiply and add with one rounding: faster, within rounding of CasADi's virtual
            machine where otherwise every bit agrees. Right and left edges given by params are taken
            not to cross.
        portable: elementary functions of exported code in place of the C library's: unless its
            numbers contain NaN, infinities or zeros of the other sign, they give the bits of
            exported C.
        form: arrangement of the lanes (default: that of `machine.environment_form`, else the one
            measured here in a long run of a step of this size, else an assumed one, which is then
            measured).
        fast_start: compile a large graph without optimisation first, which takes a quarter of the
            time. Its code is half as fast. Optimised code replaces it when a thread has compiled
            that.

    Raises:
        InputError: an entry that is not there, an instruction that cannot be compiled, or an
            invalid form.
    """
    if form is None and width != 1:
        form = environment_form()
    known = known_exogenous, known_params
    own = tuple(exogenous), tuple(params), record
    plan = _build_plan(step, rare, width, Arithmetic(fused, portable), own, known)
    measured = plan.size_class() if form is None and width != 1 else ""
    answer = cache.read_answer(measured) if measured else None
    block = cache.load_or_compile(
        plan.build_recipe(Form(*json.loads(answer)) if answer else form), KINDS, fast_start
    )
    if measured and answer is None and block.trial is None:
        block.trial = _build_trial(plan, block, measured)
    return plan.to_kernel(block)


def read_cached_kernel(step: ca.Function, rare: Sequence[ca.Function] = ()) -> Kernel | None:
    """Return the kernel of a single run that `build_kernel` would give if it is on disk, else
    None.
    """
    plan = _build_plan(step, rare, 1, Arithmetic())
    block = cache.read_cached_block(plan.build_recipe(None), KINDS)
    return None if block is None else plan.to_kernel(block)


class _Plan(NamedTuple):
    """Properties of a kernel besides its form.

    Attributes:
        functions: functions that it computes.
        shape: sizes for which it is compiled.
        width: lanes of a block, at most.
        arithmetic: how it rounds.
    """

    functions: KernelGraphs
    shape: Shape
    width: int
    arithmetic: Arithmetic

    def build_recipe(self, form: Form | None) -> cache.Recipe:
        """Return the recipe of the kernel in a form."""
        texts = [part.serialize() for part in (self.functions.usual, *self.functions.rare)]
        of = self.arithmetic, self.width, form

        def make() -> tuple[str, str]:
            """Return the text of the kernel and its note."""
            printed = print_kernel(self.functions, self.shape, host_machine(), *of)
            return printed.text, json.dumps([printed.form, printed.promises])

        return cache.Recipe("\n".join([*texts, repr((self.shape, *of))]), make)

    def to_kernel(self, block: cache.CompiledBlock) -> Kernel:
        """Return the kernel of a compiled block, with its form and assumptions."""
        form, granted = json.loads(block.note)
        return Kernel(
            block, self.shape, Form(*form), self.width, assumptions.read_assumptions(granted)
        )

    def size_class(self) -> str:
        """Return the class of kernels that share the fastest form, or "" if the form is
        not measured.
        """
        counts = [part.n_instructions() for part in (self.functions.usual, *self.functions.rare)]
        octaves = round(2.0 * math.log2(1 + counts[0])) / 2.0
        is_measured = sum(counts) <= MEASURED
        return f"form of 2^{octaves} instructions, {self.width} lanes" if is_measured else ""


def _build_plan(
    step: ca.Function,
    rare: Sequence[ca.Function],
    width: int | None,
    arithmetic: Arithmetic,
    own: tuple[tuple[int, ...], tuple[int, ...], Sequence[int] | None] = ((), (), None),
    known: tuple[Mapping[int, float], Mapping[int, float]] = ({}, {}),
) -> _Plan:
    """Return a kernel's plan.

    `own` contains exogenous, params and record, `known` the known exogenous and params of
    `build_kernel`.
    """
    sizes = (step.size1_in(0), step.size1_in(1), step.size1_in(2))
    outputs = step.size1_out(1)
    exogenous, params, record = own
    recorded = range(outputs) if record is None else record
    _require_entries("exogenous", [*exogenous, *known[0]], sizes[1])
    _require_entries("params", [*params, *known[1]], sizes[2])
    _require_entries("record", recorded, outputs)
    shape = Shape(sizes, exogenous, params, tuple(recorded))
    chosen = width or (WIDTH if shape.exogenous or shape.record else WIDE)
    return _Plan(build_graphs(step, rare, shape, *known), shape, chosen, arithmetic)


def _build_trial(plan: _Plan, block: cache.CompiledBlock, question: str) -> cache.Trial:
    """Return a kernel's block with its alternative forms, for a long run to find the fastest."""
    assumed = plan.to_kernel(block).form
    forms = host_machine().alternative_forms(assumed)
    group = math.lcm(*(form.lanes * form.streams for form in (assumed, *forms)))
    others = {
        json.dumps(form): partial(cache.load_or_compile, plan.build_recipe(form), KINDS)
        for form in forms
    }
    return cache.Trial(block, others, group, partial(cache.save_answer, question))


def run_lanes(
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
        progress: called with the number of lanes x steps done, from any thread.

    Returns:
        The outputs (lanes x stored steps x recorded) and the final states (lanes x states).

    Raises:
        ShapeError: an array of another shape.
        InputError: fused, and the edges of a zone cross.
    """
    shape = kernel.shape
    inputs = check_inputs(shape, states, exogenous, params, lane_exogenous, lane_params)
    assumptions.require_assumptions(kernel.promises, inputs.params, shape.params, inputs.own_params)
    total = len(inputs.exogenous)
    lanes = len(inputs.states)
    outputs = np.empty((lanes, -(-total // every), len(shape.record)))
    finals = np.empty((lanes, shape.sizes[0]))
    threads = threads or os.cpu_count() or 1
    width = _block_width(kernel, lanes, threads)
    schedule = _Schedule(every, _chunk_steps(shape, width, every), progress)
    spare: list[_BlockArrays] = []
    run_block = partial(_run_block, kernel, inputs, schedule, outputs, finals, width, spare)
    starts = range(0, lanes, width)
    if min(threads, len(starts)) == 1:
        for start in starts:
            run_block(start)  # a pool of threads would cost more than a short run
        return outputs, finals
    with ThreadPoolExecutor(min(threads, len(starts))) as pool:
        # A failure or Ctrl-C here drops the blocks that have not begun.
        for _ in pool.map(run_block, starts):
            pass
    return outputs, finals


def run_single_lane(
    kernel: Kernel,
    state: Floats,
    exogenous: Floats,
    params: Floats,
    progress: Callable[[int], None] | None = None,
) -> tuple[Floats, Floats]:
    """Run a single lane, as `interpret.run_interpreted`, and return outputs (N x outputs) and final
    state (states).
    """
    outputs, finals = run_lanes(kernel, state, exogenous, params, threads=1, progress=progress)
    return outputs[0], finals[0]


def _block_width(kernel: Kernel, lanes: int, threads: int) -> int:
    """Return the number of lanes of a block: whole groups, and work for every thread."""
    group = kernel.form.lanes * kernel.form.streams
    each = min(kernel.width, -(-lanes // threads))
    return -(-each // group) * group


def _require_entries(name: str, entries: Sequence[int], size: int) -> None:
    """Raise InputError if an entry does not exist."""
    for index in entries:
        if not 0 <= index < size:
            raise InputError(f"{name}: expected entries from 0 to {size - 1}, found {index}")


def _chunk_steps(shape: Shape, width: int, every: int) -> int:
    """Return the number of steps per kernel call: a multiple of `every`, and of 4 for the
    noise.
    """
    unit = math.lcm(4, every)
    numbers = width * max(UNRECORDED, len(shape.record), len(shape.exogenous))  # of a step
    return max(1, int(BUFFER // numbers) // unit) * unit


class _BlockArrays(NamedTuple):
    """Arrays in which a thread computes.

    Attributes:
        work: states and own params (rows x lanes).
        buffer: outputs of a chunk (steps x recorded x lanes).
    """

    work: Floats
    buffer: Floats


def _allocate_arrays(kernel: Kernel, width: int, steps: int) -> _BlockArrays:
    """Return arrays for blocks of the given number of lanes."""
    shape = kernel.shape
    rows = shape.sizes[0] + len(shape.params)
    buffer = np.empty((steps, len(shape.record), width))
    return _BlockArrays(_allocate_aligned(rows * width).reshape(rows, width), buffer)


def _run_block(
    kernel: Kernel,
    inputs: Inputs,
    schedule: _Schedule,
    outputs: Floats,
    finals: Floats,
    width: int,
    spare: list[_BlockArrays],
    start: int,
) -> None:
    """Run the lanes of the block from `start` on. The results are written in place."""
    states_each = kernel.shape.sizes[0]
    every = schedule.every
    total = len(inputs.exogenous)
    lanes = len(inputs.states)
    end = min(start + width, lanes)
    steps = min(schedule.chunk, total)
    arrays = spare.pop() if spare else _allocate_arrays(kernel, width, steps)
    chosen = np.minimum(np.arange(start, start + width), end - 1)  # the last lane is repeated
    arrays.work[:] = np.hstack([inputs.states[chosen], inputs.own_params[chosen]]).T
    own = inputs.supply(chosen)
    for first in range(0, total, schedule.chunk):
        count = min(schedule.chunk, total - first)
        kernel.block(
            count,
            width,
            arrays.work,
            inputs.exogenous[first : first + count],
            inputs.params,
            np.ascontiguousarray(own(first, count)),
            arrays.buffer,
        )
        block_outputs = arrays.buffer[:count:every, :, : end - start].transpose(2, 0, 1)
        at = first // every
        outputs[start:end, at : at + block_outputs.shape[1]] = block_outputs
        if schedule.progress is not None:
            schedule.progress(count * (end - start))
    finals[start:end] = arrays.work[:states_each, : end - start].T
    spare.append(arrays)


def _allocate_aligned(numbers: int) -> Floats:
    """Return an array that begins at a cache line, so that no vector crosses two lines."""
    raw = np.empty(numbers + LINE)
    start = -(raw.ctypes.data // raw.itemsize) % LINE
    return raw[start : start + numbers]


# (first step, steps), called in order -> steps x own inputs x lanes
Source = Callable[[int, int], Floats]
Supply = Callable[[Integers], Source]  # lane numbers -> their source


class Inputs(NamedTuple):
    """Checked arguments of a run.

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


def check_inputs(
    shape: Shape,
    states: Floats,
    exogenous: Floats,
    params: Floats,
    lane_exogenous: Floats | Supply | None,
    lane_params: Floats | None,
) -> Inputs:
    """Return the arguments of `run_lanes` in the shapes of a kernel. Raise ShapeError."""
    own = None if callable(lane_exogenous) else lane_exogenous
    lanes = _count_lanes(
        ("states", states, 2, 0), ("lane_exogenous", own, 3, 2), ("lane_params", lane_params, 2, 0)
    )
    total = len(exogenous)
    states_each, entries_w, entries_p = shape.sizes
    expected = (lanes, states_each) if np.ndim(states) > 1 else (states_each,)
    states = np.broadcast_to(_require_shape("states", states, *expected), (lanes, states_each))
    exogenous = np.ascontiguousarray(_require_shape("exogenous", exogenous, total, entries_w))
    params = np.ascontiguousarray(_require_shape("params", params, entries_p))
    if lane_params is None:
        lane_params = np.empty((lanes, 0))
    own_params = _require_shape("lane_params", lane_params, lanes, len(shape.params))
    if callable(lane_exogenous):
        return Inputs(states, exogenous, params, own_params, lane_exogenous)
    if own is None:
        own = np.empty((total, 0, lanes))
    own = _require_shape("lane_exogenous", own, total, len(shape.exogenous), lanes)
    return Inputs(states, exogenous, params, own_params, _to_supply(own))


def _to_supply(inputs: Floats) -> Supply:
    """Return a supply of inputs from an array (N x own inputs x lanes)."""
    return lambda lanes: lambda first, count: inputs[first : first + count, :, lanes]


def _count_lanes(*sources: tuple[str, Any, int, int]) -> int:
    """Return the number of lanes, on which all arrays have to agree.

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


def _require_shape(name: str, value: Floats, *shape: int) -> Floats:
    """Return an array of a given shape. Raise ShapeError for other shapes."""
    numbers = np.asarray(value, float)
    if numbers.shape != shape:
        present = describe_shape(numbers.shape)
        raise ShapeError(f"{name}: expected {describe_shape(shape)}, found {present}")
    return numbers
