"""The paper's loop on the lanes engine beside programs for the same work.

One run, many runs, higher orders, sampled time, growth.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from itertools import product
from typing import Any, NamedTuple

from benchmarks.engine import lanes_engine, rivals
from benchmarks.engine.work.paper_loop import Result, Time, Work, draw, error
from benchmarks.markdown import head, row
from benchmarks.timing import medians

COMPARED = 64  # runs whose result is compared with the truth
NOTE = f"""Medians of interleaved rounds; ours / its above 1: ours takes longer. Errors of final
states and of the rms of z - r, in the first {COMPARED} runs, against our result with a step
{lanes_engine.FINER} times shorter (sampled: the same step).
"""
HEAD = head("group", "program", "ns per step and run", "ours / its", "largest error")


class Entry(NamedTuple):
    """A program (None: not installed) and its work."""

    label: str
    run: Callable[[], Result] | None
    work: Work


class Timed(NamedTuple):
    """Seconds per step and run, error of final states and rms."""

    seconds: float
    error: float


def our(label: str, work: Work, **options: Any) -> Entry:
    """Our program made ready."""
    return Entry(f"**undeadzone, {label}**", lanes_engine.prepare(work, **options), work)


def rival(label: str, name: str, work: Work, **options: Any) -> Entry:
    """A file of `rivals` made ready."""
    return Entry(label, rivals.prepare(name, work, **options), work)


def race(
    entries: list[Entry], rounds: int, error: Callable[[Result, Result], float] = error
) -> list[Timed | None]:
    """Medians over interleaved rounds, after one that warms up and is checked.

    Args:
        entries: the programs
        rounds: how many
        error: of a result, given the truth

    Returns:
        Time and error of each program, None for those that are not installed.
    """
    programs, errors = {}, {}
    for i, entry in enumerate(entries):
        if entry.run is not None:
            programs[f"{i}"] = entry.run
            errors[f"{i}"] = error(entry.run(), truth(entry.work))
    timed: list[Timed | None] = [None] * len(entries)
    for name, seconds in medians(programs, rounds).items():
        work = entries[int(name)].work
        each = seconds / len(work.states) / len(work.targets)
        timed[int(name)] = Timed(each, errors[name])
    return timed


def truth(work: Work) -> Result:
    """The result of the first runs of some work, as exact as can be."""
    scenario = work.problem.scenario.simulation
    return _truth(len(work.B), scenario.duration, scenario.time)


@functools.cache
def _truth(n: int, duration: float, time: Time) -> Result:
    """`truth` of works of one kind, computed once."""
    return lanes_engine.truth(draw(COMPARED, duration, n=n, time=time))


def rows(group: str, entries: list[Entry], rounds: int = 5) -> list[str]:
    """A row for each, the first being ours."""
    timed = race(entries, rounds)
    unit = timed[0].seconds
    lines = []
    for entry, one in zip(entries, timed, strict=True):
        cells = ["not installed", "", ""]
        if one is not None:
            ratio = unit / one.seconds
            cells = [f"{1e9 * one.seconds:.3g}", f"{ratio:.2g}", f"{one.error:.1g}"]
        lines.append(row(group, entry.label, *cells))
    return lines


def alone() -> list[str]:
    """(a) One run."""
    long, short = draw(1, 20.0), draw(1, 2.0)
    exact = {"method": "DOP853", "rtol": 1e-9, "events": True}
    entries = [
        our("located", long, width=1),
        our("plain RK4", long, width=1, step="plain"),
        rival("C, located", "c", long, width=1),
        rival("C, plain RK4", "c", long, width=1, step="plain"),
        rival("heyoka, events, tol 1e-9", "heyoka_events", long),
        rival("JAX, plain RK4", "jax_scan", long, unroll=8),
        rival("diffrax, Tsit5 1e-6", "diffrax_tsit5", long),
        rival("SciPy, RK45 1e-6 (2 s)", "scipy_ivp", short),
        rival("SciPy, DOP853 1e-9, events (2 s)", "scipy_ivp", short, **exact),
    ]
    return rows("(a) one run", entries)


def many(runs: int, duration: float) -> list[str]:
    """(b) Many runs: against C of the same kind in pairs, against the others all together."""
    work, few = draw(runs, duration), draw(10, duration)
    lines = []
    names = {"located": "located", "plain": "plain RK4"}
    for threads, step, known in product((1, 2), names, (False, True)):
        options = {"step": step, "known": known, "threads": threads}
        label = names[step] + (", zeros and ones known" if known else "")
        pair = [our(label, work, **options), rival(f"C, {label}", "c", work, **options)]
        lines += rows(f"(b) {runs} runs, {_threads(threads)}", pair)
    others = [
        rival("heyoka in batches, events, tol 1e-9", "heyoka_events", work, batch=True),
        rival("JAX, plain RK4", "jax_scan", work),
        rival("SciPy, RK45 1e-6 (10 runs)", "scipy_ivp", few),
    ]
    if runs <= 1000:
        others.append(rival("diffrax, Tsit5 1e-6", "diffrax_tsit5", work))
    return lines + rows(f"(b) {runs} runs", [our("located", work), *others], rounds=3)


def orders() -> list[str]:
    """(c) Orders 2 to 12: besides, time per instruction of the graph."""
    lines: list[str] = []
    costs = {}
    for n in (2, 4, 8, 12):
        work = draw(512, 2.0, n=n)
        entries = [our("located", work), rival("C, located", "c", work)]
        lines += rows(f"(c) order {n}", entries)
        costs[n] = race(entries[:1], 5)[0].seconds / lanes_engine.instructions(work, "located")
    growth = ", ".join(f"{n}: {cost / costs[2]:.2f}" for n, cost in costs.items())
    what = "time per instruction of the graph, order 2 being 1"
    return [*lines, f"| (c) all orders | {what} | {growth} | | |"]


def digital() -> list[str]:
    """(d) Sampled time."""
    lone, work = draw(1, 20.0, time="sampled"), draw(1000, 20.0, time="sampled")
    in_c = rival("C, sampled", "c", lone, width=1, step="sampled")
    lines = rows("(d) sampled, one run", [our("sampled", lone, width=1), in_c])
    for threads in (1, 2):
        options = {"step": "sampled", "threads": threads}
        pair = [our("sampled", work, **options), rival("C, sampled", "c", work, **options)]
        lines += rows(f"(d) sampled, 1000 runs, {_threads(threads)}", pair)
    return lines


def _threads(count: int) -> str:
    """A number of threads in words."""
    return f"{count} thread{'s' * (count > 1)}"


def growth() -> list[str]:
    """(h) Runs and steps: what one step of one run costs stays the same."""
    lines = []
    for runs, steps in ((128, 2000), (1024, 2000), (16384, 2000), (1024, 20000)):
        work = draw(runs, steps * 1e-3)
        pair = [our("located", work), rival("C, located", "c", work)]
        lines += rows(f"(h) {runs} runs of {steps} steps", pair)
    return lines


def table() -> str:
    """All of it."""
    lines = [*alone(), *many(1000, 4.0), *many(10_000, 4.0), *orders(), *digital(), *growth()]
    return "\n".join(["## Speed\n", NOTE, *HEAD, *lines, ""])
