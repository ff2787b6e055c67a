"""The paper's loop on the lanes engine beside programs for the same work: one run, many runs, higher orders, sampled time, growth."""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from benchmarks import ours, rivals
from benchmarks.workload import Result, Time, Work, draw, error

CHECKED = 64  # runs whose result is compared with the truth
NOTE = f"""Medians of interleaved rounds; ours / its above 1: ours takes longer. Errors of final states and of the rms of z - r, in the first {CHECKED}
runs, against our result with a step {ours.FINER} times shorter (sampled: the same step).
"""
HEAD = (
    "| group | program | ns per step and run | ours / its | largest error |\n|---|---|---|---|---|"
)


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
    return Entry(f"**undeadzone, {label}**", ours.prepare(work, **options), work)


def rival(label: str, name: str, work: Work, **options: Any) -> Entry:
    return Entry(label, rivals.prepare(name, work, **options), work)


def race(
    entries: list[Entry], rounds: int, error: Callable[[Result, Result], float] = error
) -> list[Timed | None]:
    """Medians over interleaved rounds, after one that warms up and is checked; error: of a result, given the truth."""
    errors = [entry.run and error(entry.run(), truth(entry.work)) for entry in entries]
    times: list[list[float]] = [[] for _ in entries]
    for _ in range(rounds):
        for entry, found in zip(entries, times, strict=True):
            if entry.run is not None:
                began = time.perf_counter()
                entry.run()
                found.append(
                    (time.perf_counter() - began) / len(entry.work.states) / len(entry.work.targets)
                )
    return [
        Timed(statistics.median(found), gap) if found else None
        for found, gap in zip(times, errors, strict=True)
    ]


def truth(work: Work) -> Result:
    scenario = work.problem.scenario.simulation
    return _truth(len(work.B), scenario.duration, scenario.time)


@functools.cache
def _truth(n: int, duration: float, time: Time) -> Result:
    return ours.truth(draw(CHECKED, duration, n=n, time=time))


def rows(group: str, entries: list[Entry], rounds: int = 5) -> list[str]:
    """A row for each, the first being ours."""
    timed = race(entries, rounds)
    unit = timed[0].seconds
    lines = []
    for entry, found in zip(entries, timed, strict=True):
        cells = (
            ["not installed", "", ""]
            if found is None
            else [f"{1e9 * found.seconds:.3g}", f"{unit / found.seconds:.2g}", f"{found.error:.1g}"]
        )
        lines.append(f"| {group} | {entry.label} | {' | '.join(cells)} |")
    return lines


def alone() -> list[str]:
    """(a) One run."""
    long, short, shorter = (draw(1, duration) for duration in (20.0, 2.0, 0.2))
    return rows(
        "(a) one run",
        [
            our("located", long, width=1),
            our("plain RK4", long, width=1, step="plain"),
            rival("C, located", "c", long, width=1),
            rival("C, plain RK4", "c", long, width=1, step="plain"),
            rival("heyoka, events, tol 1e-9", "heyoka_events", long),
            rival("JAX, plain RK4", "jax_scan", long, unroll=8),
            rival("diffrax, Tsit5 1e-6", "diffrax_tsit5", long),
            rival("CasADi fold, plain RK4", "casadi_map", long),
            rival("SciPy, RK45 1e-6 (2 s)", "scipy_ivp", short),
            rival(
                "SciPy, DOP853 1e-9, events (2 s)",
                "scipy_ivp",
                short,
                method="DOP853",
                rtol=1e-9,
                events=True,
            ),
            rival("python-control, RK45 1e-6 (0.2 s)", "python_control", shorter),
            rival("PathSim, plain RK4 (0.2 s)", "pathsim_blocks", shorter),
        ],
    )


def many(runs: int, duration: float) -> list[str]:
    """(b) Many runs: against C of the same kind in pairs, against the others all together."""
    work, few = draw(runs, duration), draw(10, duration)
    lines = []
    for threads in (1, 2):
        for step in ("located", "plain"):
            for known in (False, True):
                options = {"step": step, "known": known, "threads": threads}
                label = f"{'located' if step == 'located' else 'plain RK4'}{', zeros and ones known' if known else ''}"
                group = f"(b) {runs} runs, {threads} thread{'s' * (threads > 1)}"
                lines += rows(
                    group, [our(label, work, **options), rival(f"C, {label}", "c", work, **options)]
                )
    others = [
        rival("heyoka in batches, events, tol 1e-9", "heyoka_events", work, batch=True),
        rival("JAX, plain RK4", "jax_scan", work),
        rival("CasADi map, plain RK4 (100 runs)", "casadi_map", draw(100, duration)),
        rival("SciPy, RK45 1e-6 (10 runs)", "scipy_ivp", few),
    ]
    if runs <= 1000:
        others.append(rival("diffrax, Tsit5 1e-6", "diffrax_tsit5", work))
    return lines + rows(f"(b) {runs} runs", [our("located", work), *others], rounds=3)


def orders() -> list[str]:
    """(c) Orders 2 to 12: besides, time per instruction of the graph."""
    lines, costs = [], {}
    for n in (2, 4, 8, 12):
        work = draw(512, 2.0, n=n)
        entries = [our("located", work), rival("C, located", "c", work)]
        lines += rows(f"(c) order {n}", entries)
        costs[n] = race(entries[:1], 5)[0].seconds / ours.instructions(work, "located")
    growth = ", ".join(f"{n}: {cost / costs[2]:.2f}" for n, cost in costs.items())
    return [
        *lines,
        f"| (c) all orders | time per instruction of the graph, order 2 being 1 | {growth} | | |",
    ]


def digital() -> list[str]:
    """(d) Sampled time."""
    lone, work = draw(1, 20.0, time="sampled"), draw(1000, 20.0, time="sampled")
    lines = rows(
        "(d) sampled, one run",
        [our("sampled", lone, width=1), rival("C, sampled", "c", lone, width=1, step="sampled")],
    )
    for threads in (1, 2):
        group, options = (
            f"(d) sampled, 1000 runs, {threads} thread{'s' * (threads > 1)}",
            {"step": "sampled", "threads": threads},
        )
        lines += rows(
            group, [our("sampled", work, **options), rival("C, sampled", "c", work, **options)]
        )
    return lines


def growth() -> list[str]:
    """(h) Runs and steps: what one step of one run costs stays the same."""
    works = {
        f"(h) {runs} runs of {steps} steps": draw(runs, steps * 1e-3)
        for runs, steps in ((128, 2000), (1024, 2000), (16384, 2000), (1024, 20000))
    }
    return [
        line
        for group, work in works.items()
        for line in rows(group, [our("located", work), rival("C, located", "c", work)])
    ]


def table() -> str:
    """All of it."""
    lines = [*alone(), *many(1000, 4.0), *many(10_000, 4.0), *orders(), *digital(), *growth()]
    return "\n".join(["## Speed\n", NOTE, HEAD, *lines, ""])
