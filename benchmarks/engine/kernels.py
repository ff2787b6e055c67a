"""Kernels of the lanes engine beside C by hand, in the form assumed and in the one measured."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from benchmarks.engine import lanes_engine, rivals
from benchmarks.engine.work.paper_loop import Work, draw
from benchmarks.markdown import head, row
from undeadzone.compile import cache, lanes, machine
from undeadzone.compile.machine import FIXED, Form, Machine, host_machine

RUNS, STEPS = 1008, 1000  # whole groups of two streams, and of three
# Lanes, streams, slots, registers: what was chosen, and what other processors may want.
FORMS = tuple(
    Form(lanes, streams, bool(slots), *rest)
    for lanes, streams, slots, *rest in (
        *((8, 2, 1, 20), (8, 2, 0, 20), (8, 2, 0, 12), (8, 2, 0, 0), (8, 1, 1, 26), (8, 1, 0, 26)),
        *((8, 1, 1, 0, 300), (8, 3, 1, 13), (8, 3, 0, 13), (8, 3, 0, 0), (4, 2, 0, 20)),
    )
)
LONGEST = 16  # streams times order: beyond it a form takes a minute to compile
AVX2 = "haswell", "+avx2,+fma,+bmi,+bmi2"
OF_AVX2 = (
    *(Form(4, 1, False, 0, 300), Form(4, 1, False, 26)),
    *(Form(4, 2, False, registers) for registers in (20, 12, 0)),
)
NOTE = f"""ns per step and run of {RUNS} runs of {STEPS} steps on one thread, least CPU time of
interleaved rounds; in brackets, as a share of C's. "C, grouped" has the sum of RK4 as our graph has
it, k1 + k4 + 2 (k2 + k3). Forms are lanes, streams, slots and registers ({FIXED}): the one that is
assumed, and the one that a long run found to be the fastest, as an ensemble does; a loop shares it
with those of its size, and of long steps none is measured. `lanes.run` is the call with 1000 runs,
checks and copies included, as a share of its kernel.
"""


class Loop(NamedTuple):
    """A loop to compare.

    Attributes:
        name: in the table
        options: of `draw`
        step: located, plain or sampled
        known: zeros and ones are known
    """

    name: str
    options: dict[str, Any]
    step: str
    known: bool = False


LOOPS = (
    Loop("plain RK4", {}, "plain"),
    Loop("located", {}, "located"),
    Loop("sampled", {"time": "sampled"}, "sampled"),
    Loop("plain RK4, zeros and ones known", {}, "plain", True),
    Loop("located, zeros and ones known", {}, "located", True),
    Loop("order 4, located", {"n": 4}, "located"),
    Loop("order 8, located", {"n": 8}, "located"),
    Loop("order 12, located", {"n": 12}, "located"),
)


def table(rounds: int = 16) -> str:
    """The table of kernels."""
    columns = ("loop", "C", "C, grouped", "assumed", "kernel", "measured", "kernel")
    machine = host_machine()
    size = machine.vector_shape[0]
    lines = [f"## Kernels\n\n{machine.processor}, vectors of {size}. {NOTE}"]
    lines += head(*columns, "`lanes.run` / kernel")
    with tempfile.TemporaryDirectory() as folder, variable("UNDEADZONE_CACHE", folder):
        for loop in LOOPS:
            lines.append(_row(loop, rounds))
        lines += ["", *_forms(LOOPS, FORMS, rounds // 4)]
    with as_machine(Machine(host_machine().triple, *AVX2)):
        return "\n".join([*lines, *_forms(LOOPS[:6], OF_AVX2, rounds // 4)])


@contextmanager
def as_machine(other: Machine) -> Iterator[None]:
    """Code for another machine, which has to run on this one, too."""
    rooms: tuple[Any, ...] = (cache, lanes, machine)
    with tempfile.TemporaryDirectory() as folder, variable("UNDEADZONE_CACHE", folder):
        for room in rooms:
            room.here = lambda: other
        cache.load_or_compile.cache_clear()
        try:
            yield
        finally:
            for room in rooms:
                room.here = host_machine
            cache.load_or_compile.cache_clear()


def _forms(loops: Sequence[Loop], forms: Sequence[Form], rounds: int) -> list[str]:
    """The forms of loops, as shares of the one that is assumed."""
    titles, columns = [], []
    for loop in loops:
        work, options = _work_of(loop)
        own = assumed(work, **options)
        titles.append(f"{loop.name} ({own.kernel.form.setting_text})")
        programs = {"assumed": alone(own, work)}
        for form in forms:
            if form.streams * loop.options.get("n", 2) <= LONGEST:
                programs[form.setting_text] = alone(formed(form, work, **options), work)
        seconds = least(programs, rounds)
        whole = seconds["assumed"]
        columns.append({name: f"{value / whole:.2f}" for name, value in seconds.items()})
    names = [form.setting_text for form in forms]
    code = f"Code for {machine.host_machine().processor} on {host_machine().processor}"
    lines = [f"{code}: time of a kernel in other forms over that in the assumed one.\n"]
    lines += head("form", *titles)
    lines += [row(name, *(column.get(name, "-") for column in columns)) for name in names]
    return [*lines, ""]


def _work_of(loop: Loop) -> tuple[Work, dict[str, Any]]:
    """The work of a loop, and how it is computed."""
    work = draw(RUNS, STEPS * 1e-3, **loop.options)
    return work, {"step": loop.step, "known": loop.known}


@contextmanager
def variable(name: str, value: str) -> Iterator[None]:
    """A variable of the environment for a while."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name)
        if before is not None:
            os.environ[name] = before


def formed(form: Form, work: Work, **options: Any) -> lanes_engine.Program:
    """The program in a form."""
    with variable(FIXED, form.setting_text):
        return lanes_engine.build_program(work, **options)


def assumed(work: Work, **options: Any) -> lanes_engine.Program:
    """The program in the form that is assumed, and stays so."""
    with tempfile.TemporaryDirectory() as folder, variable("UNDEADZONE_CACHE", folder):
        form = lanes_engine.build_program(work, **options).kernel.form
    return formed(form, work, **options)


def measured(work: Work, **options: Any) -> lanes_engine.Program:
    """The program after runs long enough for its form to be measured."""
    while True:
        program = lanes_engine.build_program(work, **options)
        trial = program.kernel.block.trial
        if trial is None or trial.is_done:
            return lanes_engine.build_program(work, **options)
        run = alone(program, work)
        for _ in range(100):
            run()


def _row(loop: Loop, rounds: int) -> str:
    """One loop."""
    work, options = _work_of(loop)
    few = draw(1000, STEPS * 1e-3, **loop.options)
    before, after = assumed(work, **options), measured(work, **options)
    programs = {
        "C": rivals.prepare("c", work, **options),
        "grouped": rivals.prepare("c", work, grouped=True, **options),
        "assumed": alone(before, work),
        "measured": alone(after, work),
        "run": lanes_engine.prepare(few, **options),
    }
    seconds = least({name: one for name, one in programs.items() if one is not None}, rounds)
    each = {name: 1e9 * value / STEPS / RUNS for name, value in seconds.items()}
    each["run"] *= RUNS / 1000
    cells = [f"{each['C']:.3g}" if "C" in each else "not installed"]
    for name in ("grouped", "assumed", "measured"):
        share = f" ({each[name] / each['C']:.2f})" if "C" in each and name in each else ""
        cells.append(f"{each[name]:.3g}{share}" if name in each else "not installed")
    cells[2:2] = [before.kernel.form.setting_text]
    cells[4:4] = [after.kernel.form.setting_text]
    return row(loop.name, *cells, f"{each['run'] / each['measured']:.2f}")


def alone(program: lanes_engine.Program, work: Work) -> Callable[[], None]:
    """A kernel's own calls, without `lanes.run`."""
    kernel, states = program.kernel, program.states
    kernel.block.wait_until_best()
    own = np.empty((STEPS, 0, len(states)))
    arrays = lanes._allocate_arrays(kernel, len(states), STEPS)

    def run() -> None:
        arrays.work[: states.shape[1]] = states.T
        arrays.work[states.shape[1] :] = work.widths.T
        shared = (program.exogenous, program.params, own, arrays.buffer)
        kernel.block(len(program.exogenous), len(states), arrays.work, *shared)

    return run


def least(programs: dict[str, Callable[[], Any]], rounds: int) -> dict[str, float]:
    """The least CPU time of each program [s], in interleaved rounds after one that warms up."""
    times: dict[str, list[float]] = {name: [] for name in programs}
    for k in range(rounds + 1):
        for name, program in programs.items():
            began = time.process_time()
            program()
            if k:
                times[name].append(time.process_time() - began)
    return {name: min(values) for name, values in times.items()}
