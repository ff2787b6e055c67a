"""Kernels of the lanes engine in the form that is assumed, and in others.

`speed` has the same loops beside C by hand.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.engine import lanes_engine
from benchmarks.engine.work.paper_loop import Work, draw
from benchmarks.markdown import head, row
from benchmarks.timing import least
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
NOTE = f"""Time of {RUNS} runs of {STEPS} steps on one thread, least CPU time of interleaved rounds.
Forms are lanes, streams, slots and registers ({FIXED}).
"""


def setting_text(form: Form) -> str:
    """Return a form as `FIXED` contains it, for example 8,2,0,20. `piece` has no text."""
    numbers = form[: 5 if form.branches else 4]
    return ",".join(str(int(number)) for number in numbers)


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


def table(rounds: int = 4) -> str:
    """The table of kernels."""
    lines = [f"## Kernels\n\n{NOTE}", *_forms(LOOPS, FORMS, rounds)]
    with as_machine(Machine(host_machine().triple, *AVX2)):
        return "\n".join([*lines, *_forms(LOOPS[:6], OF_AVX2, rounds)])


@contextmanager
def as_machine(other: Machine) -> Iterator[None]:
    """Code for another machine, which has to run on this one, too."""
    with ExitStack() as changes:
        changes.enter_context(private_cache())
        for room in (cache, lanes, machine):
            changes.enter_context(patch.object(room, "host_machine", lambda: other))
        cache.load_or_compile.cache_clear()
        yield
    cache.load_or_compile.cache_clear()


@contextmanager
def private_cache() -> Iterator[None]:
    """A cache of kernels that is empty at first."""
    with (
        tempfile.TemporaryDirectory() as folder,
        patch.dict(os.environ, UNDEADZONE_CACHE=folder),
    ):
        yield


def _forms(loops: Sequence[Loop], forms: Sequence[Form], rounds: int) -> list[str]:
    """The forms of loops, as shares of the one that is assumed."""
    titles, columns = [], []
    for loop in loops:
        work, options = _work_of(loop)
        own = assumed(work, **options)
        titles.append(f"{loop.name} ({setting_text(own.kernel.form)})")
        programs = {"assumed": alone(own, work)}
        for form in forms:
            if form.streams * loop.options.get("n", 2) <= LONGEST:
                programs[setting_text(form)] = alone(formed(form, work, **options), work)
        seconds = least(programs, rounds, time.process_time)
        whole = seconds["assumed"]
        columns.append({name: f"{value / whole:.2f}" for name, value in seconds.items()})
    names = [setting_text(form) for form in forms]
    code = f"Code for {machine.host_machine().processor} on {host_machine().processor}"
    lines = [f"{code}: time of a kernel in other forms over that in the assumed one.\n"]
    lines += head("form", *titles)
    lines += [row(name, *(column.get(name, "-") for column in columns)) for name in names]
    return [*lines, ""]


def _work_of(loop: Loop) -> tuple[Work, dict[str, Any]]:
    """The work of a loop, and how it is computed."""
    work = draw(RUNS, STEPS * 1e-3, **loop.options)
    return work, {"step": loop.step, "known": loop.known}


def formed(form: Form, work: Work, **options: Any) -> lanes_engine.Program:
    """The program in a form."""
    with patch.dict(os.environ, {FIXED: setting_text(form)}):
        return lanes_engine.build_program(work, **options)


def assumed(work: Work, **options: Any) -> lanes_engine.Program:
    """The program in the form that is assumed, and stays so."""
    with private_cache():
        form = lanes_engine.build_program(work, **options).kernel.form
    return formed(form, work, **options)


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
