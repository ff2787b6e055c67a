"""Robot arms: UR5 on the lanes engine beside Pinocchio and MuJoCo, then accuracy (arm_accuracy)."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.engine import arm_accuracy
from benchmarks.engine.work.arm_moves import MOVES, Move, draw, lanes_run, virtual_machine
from benchmarks.markdown import head, row
from undeadzone_studies.ensemble.batch import Batch

STEPS = 100
THREADS = (1, 2)
TITLES = {
    "euler": "forward dynamics once a step (Euler)",
    "rk4": "RK4: forward dynamics four times a step",
    "follow": "RK4 and computed torque on the true state",
}
NOTE = f"""UR5, {STEPS} steps of 1 ms. The least of interleaved rounds; ours / its above 1: ours
takes longer. The largest difference is of a final state from ours. Goals of an arm's step: ours at
most 0.2 of `pin.aba` called from Python, at most 2 of the loop in C++. Ours is compiled for this
arm; Pinocchio and MuJoCo read theirs at run time. 10^4 arms over 5 s at 1 kHz are 5e7 of them.
"""
HEAD = head("work", "program", "us per arm and step", "ours / its", "largest difference")


class Entry(NamedTuple):
    """A program, or why there is none; count: arms times steps of one call."""

    label: str
    run: Callable[[], Any] | str
    count: int


def entry(
    label: str, make: Callable[..., Callable[[], Any]], move: Move, runs: int, **options: Any
) -> Entry:
    """A program made ready for so many arms, or why it cannot be."""
    try:
        return Entry(label, make(draw(move, runs, STEPS), **options), runs * STEPS)
    except ImportError as missing:
        return Entry(label, str(missing), 1)


def rival(label: str, name: str, function: str, move: Move, runs: int, **options: Any) -> Entry:
    """The same for a function of a file of `rivals`, which is imported here."""

    def make(*args: Any, **kwargs: Any) -> Callable[[], Any]:
        module = importlib.import_module(f"benchmarks.engine.rivals.{name}")
        return getattr(module, function)(*args, **kwargs)

    return entry(label, make, move, runs, **options)


def rows(group: str, entries: list[Entry], rounds: int = 20, *, alike: bool = True) -> list[str]:
    """A row for each, the first being ours; alike: they compute the same final states."""
    finals = [_final(one) for one in entries]
    best = [math.inf] * len(entries)
    for _ in range(rounds):
        for i, one in enumerate(entries):
            if callable(one.run):
                began = time.perf_counter()
                one.run()
                best[i] = min(best[i], (time.perf_counter() - began) / one.count)
    lines = []
    for one, seconds, states in zip(entries, best, finals, strict=True):
        if callable(one.run):
            apart = _apart(finals[0], states) if alike else ""
            cells = [f"{1e6 * seconds:.3g}", f"{best[0] / seconds:.2g}", apart]
        else:
            cells = [one.run, "", ""]
        lines.append(row(group, one.label, *cells))
    return lines


def _final(entry: Entry) -> Any:
    """The final states of a program, None if there is none."""
    return entry.run() if callable(entry.run) else None


def _apart(ours: Any, its: Any) -> str:
    """The largest difference of the states of the runs that both have."""
    if its is ours or its is None:
        return ""
    runs = min(len(ours), len(its))
    return f"{np.abs(ours[:runs] - its[:runs]).max():.0e}"


def _threads(count: int) -> str:
    """A number of threads in words."""
    return f"{count} thread{'s' * (count > 1)}"


def simulators(move: Move, threads: int) -> list[str]:
    """Whatever moves arms, on so many threads."""
    many = "**undeadzone, lanes, 1024 arms**"
    in_cpp = ("Pinocchio, loop in C++", "pinocchio_arm", "compiled_loop")
    rolled = ("MuJoCo, rollout", "mujoco_arm", "prepare")
    entries = [
        entry(many, lanes_run, move, 1024, threads=threads),
        rival(*in_cpp, move, 64, threads=threads),
    ]
    if move != "follow":
        entries.append(rival(*rolled, move, 64, rolled=True, threads=threads))
    if threads == 1:
        entries += _alone(move)
    return rows(f"{TITLES[move]}, {_threads(threads)}", entries)


def _alone(move: Move) -> list[Entry]:
    """What moves one arm after the other."""
    entries = [
        entry("**undeadzone, lanes, one arm**", lanes_run, move, 1, width=1),
        entry("**undeadzone, CasADi's virtual machine**", virtual_machine, move, 4),
        rival("Pinocchio, loop in Python", "pinocchio_arm", "prepare", move, 4),
    ]
    if move != "follow":
        entries.append(rival("MuJoCo, mj_step from Python", "mujoco_arm", "prepare", move, 4))
    if move == "euler":
        calls = "Pinocchio, pin.aba from Python, the calls alone"
        entries.append(rival(calls, "pinocchio_arm", "calls", move, 1))
    return entries


def whole(fleet: Batch, runs: int = 512) -> list[str]:
    """The ensemble's loop with all that belongs to it, beside bare dynamics."""
    short = fleet._replace(exogenous=fleet.exogenous[:STEPS])
    numbers = np.arange(runs)
    drawn = fleet.binding.numbers.to_lanes(fleet.binding.draw_columns(0, runs, fleet.layout.runs))
    method = arm_accuracy.method(fleet.problem.scenario)
    label = f"**undeadzone, lanes, {runs} arms: RK4, dead zones, noise, `{method}`, controller**"
    lines = []
    for threads in THREADS:
        measure = functools.partial(short.measure_lanes, numbers, drawn, threads)
        entries = [Entry(label, measure, runs * STEPS), *_bare(threads)]
        lines += rows(f"whole closed loop, {_threads(threads)}", entries, 10, alike=False)
    return lines


def _bare(threads: int) -> list[Entry]:
    """Pinocchio's dynamics without anything that reads or estimates."""
    once = ("Pinocchio, loop in C++, forward dynamics once a step", "pinocchio_arm")
    following = ("Pinocchio, loop in C++, RK4 and computed torque", "pinocchio_arm")
    calls = ("Pinocchio, pin.aba from Python, the calls alone", "pinocchio_arm")
    in_python = ("Pinocchio, loop in Python, RK4 and computed torque", "pinocchio_arm")
    entries = [
        rival(*once, "compiled_loop", "euler", 64, threads=threads),
        rival(*following, "compiled_loop", "follow", 64, threads=threads),
    ]
    if threads == 1:
        entries.append(rival(*calls, "calls", "euler", 1))
        entries.append(rival(*in_python, "prepare", "follow", 4))
    return entries


def table() -> str:
    """Speed, then accuracy."""
    if importlib.util.find_spec("adam") is None:
        return "## Robot arms\n\nNot measured: adam-robotics is not installed.\n"
    loop = arm_accuracy.fleet("ur5")
    assert loop is not None
    lines = ["## Robot arms\n", NOTE, *HEAD]
    for move in MOVES:
        for threads in THREADS:
            lines += simulators(move, threads)
    lines += whole(loop)
    return "\n".join([*lines, *arm_accuracy.lines(("two_link", "ur5")), ""])
