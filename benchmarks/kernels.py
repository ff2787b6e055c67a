"""Kernels of the lanes engine beside C by hand, and what their first compilation takes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from benchmarks import ours, rivals
from benchmarks.markdown import head, row
from benchmarks.workload import Work, draw
from undeadzone.compile import lanes
from undeadzone.compile.machine import FIXED, here

RUNS, STEPS = 1024, 1000
# Lanes, streams, slots, registers: what was chosen, and what other processors may want.
FORMS = ((8, 2, 1, 20), (8, 2, 0, 20), (8, 2, 0, 0), (8, 1, 1, 26), (8, 1, 0, 26), (4, 2, 0, 20))
NOTE = f"""ns per step and run of {RUNS} runs of {STEPS} steps on one thread, least CPU time of
interleaved rounds; in brackets, as a share of C's. "C, grouped" has the sum of RK4 as our graph has
it, k1 + k4 + 2 (k2 + k3). `lanes.run` is the call with 1000 runs, checks and copies included, as a
share of its kernel.
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


def table(rounds: int = 40) -> str:
    """The table of kernels."""
    columns = ("loop", "C", "C, grouped", "kernel", "`lanes.run` / kernel")
    lines = ["## Kernels\n", NOTE, *head(*columns)]
    for loop in LOOPS:
        lines.append(_row(loop, rounds))
    return "\n".join([*lines, "", *_forms(rounds // 4)])


def _forms(rounds: int) -> list[str]:
    """The forms of the first loops, as shares of the one that is chosen."""
    names = [loop.name for loop in LOOPS]
    lines = [
        f"{here().processor}: time of a kernel in other forms ({FIXED}) over that in its own.\n",
        *head("form", *names),
    ]
    columns = []
    for loop in LOOPS:
        work = draw(RUNS, STEPS * 1e-3, **loop.options)
        programs = {"own": alone(work, step=loop.step, known=loop.known)}
        for form in FORMS:
            with patched(form):
                programs[form_name(form)] = alone(work, step=loop.step, known=loop.known)
        seconds = least(programs, rounds)
        columns.append({name: f"{value / seconds['own']:.2f}" for name, value in seconds.items()})
    for form in FORMS:
        lines.append(row(form_name(form), *(column[form_name(form)] for column in columns)))
    return [*lines, ""]


def form_name(form: tuple[int, ...]) -> str:
    """A form as the environment tells it."""
    return ",".join(map(str, form))


@contextmanager
def patched(form: tuple[int, ...]) -> Iterator[None]:
    """A form in the environment."""
    os.environ[FIXED] = form_name(form)
    try:
        yield
    finally:
        del os.environ[FIXED]


def _row(loop: Loop, rounds: int) -> str:
    """One loop."""
    work = draw(RUNS, STEPS * 1e-3, **loop.options)
    few = draw(1000, STEPS * 1e-3, **loop.options)
    options = {"step": loop.step, "known": loop.known}
    programs = {
        "C": rivals.prepare("c", work, **options),
        "grouped": rivals.prepare("c", work, grouped=True, **options),
        "kernel": alone(work, **options),
        "run": ours.prepare(few, **options),
    }
    seconds = least({name: one for name, one in programs.items() if one is not None}, rounds)
    each = {name: 1e9 * value / STEPS / RUNS for name, value in seconds.items()}
    each["run"] *= RUNS / 1000
    shown = [f"{each['C']:.3g}" if "C" in each else "not installed"]
    for name in ("grouped", "kernel"):
        share = f" ({each[name] / each['C']:.2f})" if "C" in each and name in each else ""
        shown.append(f"{each[name]:.3g}{share}" if name in each else "not installed")
    return row(loop.name, *shown, f"{each['run'] / each['kernel']:.2f}")


def alone(work: Work, **options: Any) -> Callable[[], None]:
    """A kernel's own calls, without `lanes.run`."""
    program = ours.made(work, **options)
    kernel, states = program.kernel, program.states
    own = np.empty((STEPS, 0, len(states)))
    arrays = lanes._arrays(kernel, len(states), STEPS)

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
