"""Error against cost over step sizes and tolerances (work-precision): the paper's loop, 10 s, final states."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import ours, rivals
from benchmarks.speed import Entry, race
from benchmarks.workload import Result, Work, draw, final_error
from undeadzone.report import style

FIGURE = Path(__file__).with_name("precision.png")
DURATION = 10.0
STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)
LONG_STEPS = (40e-3, 20e-3, 10e-3)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
RUNS = 1024
GOAL = 1e-9


class Curve(NamedTuple):
    """A program over its settings: how it is made ready for one, its work for one, and its look."""

    name: str
    make: Callable[[Work, float], Callable[[], Result] | None]
    work: Callable[[float], Work]
    settings: tuple[float, ...]
    colour: str
    line: str


def curves() -> list[Curve]:
    def stepped(runs: int) -> Callable[[float], Work]:
        return lambda step: _final(draw(runs, DURATION, step=step))

    def given(runs: int) -> Callable[[float], Work]:
        return lambda tolerance: _final(draw(runs, DURATION))

    def rival(
        name: str, tolerance: str, **options: Any
    ) -> Callable[[Work, float], Callable[[], Result] | None]:
        return lambda work, value: rivals.prepare(name, work, **{tolerance: value}, **options)

    return [
        Curve(
            f"undeadzone, {RUNS} runs",
            lambda work, step: ours.prepare(work),
            stepped(RUNS),
            STEPS,
            style.ESTIMATE,
            "-",
        ),
        Curve(
            "undeadzone, one run",
            lambda work, step: ours.prepare(work, width=1),
            stepped(1),
            STEPS,
            style.ESTIMATE,
            "--",
        ),
        Curve(
            f"undeadzone, Taylor 8, {RUNS} runs",
            lambda work, step: ours.prepare(work, order=8),
            stepped(RUNS),
            LONG_STEPS,
            style.OTHER,
            "-",
        ),
        Curve(
            "undeadzone, Taylor 8, one run",
            lambda work, step: ours.prepare(work, order=8, width=1),
            stepped(1),
            LONG_STEPS,
            style.OTHER,
            "--",
        ),
        Curve(
            f"undeadzone, plain RK4, {RUNS} runs",
            lambda work, step: ours.prepare(work, step="plain"),
            stepped(RUNS),
            STEPS,
            style.ZONE,
            "-",
        ),
        Curve(
            f"heyoka, events, {RUNS} runs in batches",
            rival("heyoka_events", "tol", batch=True),
            given(RUNS),
            TOLERANCES,
            style.PRINTED,
            "-",
        ),
        Curve(
            "heyoka, events, one run",
            rival("heyoka_events", "tol"),
            given(1),
            TOLERANCES,
            style.PRINTED,
            "--",
        ),
        Curve(
            "diffrax, Tsit5, 64 runs",
            rival("diffrax_tsit5", "rtol"),
            given(64),
            TOLERANCES[1:3],
            style.REFERENCE,
            "-",
        ),
        Curve(
            "SciPy, RK45, one run",
            rival("scipy_ivp", "rtol"),
            given(1),
            TOLERANCES[:2],
            style.OTHER,
            "--",
        ),
        Curve(
            "SciPy, DOP853, events, one run",
            rival("scipy_ivp", "rtol", method="DOP853", events=True),
            given(1),
            TOLERANCES[:4],
            style.READING,
            "--",
        ),
    ]


def _final(work: Work) -> Work:
    """The work with a rms over one step only: final states are what counts here."""
    return work._replace(tail=1)


def table(rounds: int = 5) -> str:
    """The error and cost of each, and the cost at an error of `GOAL`."""
    found = {curve: _points(curve, rounds) for curve in curves()}
    _draw(found)
    heads = f"| program | largest error: us per run and second simulated | us at {GOAL:g} |\n|---|---|---|"
    lines = [
        f"| {curve.name} | {', '.join(f'{error:.0e}: {1e6 * cost:.3g}' for error, cost in points)} | {_at_goal(points)} |"
        for curve, points in found.items()
    ]
    return "\n".join(
        ["## Precision\n", f"![error against cost]({FIGURE.name})\n", heads, *lines, ""]
    )


def _points(curve: Curve, rounds: int) -> list[tuple[float, float]]:
    """(largest error of a final state, seconds per run and second simulated) for each setting; none where it is not installed."""
    works = [curve.work(setting) for setting in curve.settings]
    entries = [
        Entry(curve.name, curve.make(work, setting), work)
        for work, setting in zip(works, curve.settings, strict=True)
    ]
    timed = race(entries, rounds, final_error)
    return [
        (one.error, one.seconds / entry.work.step)
        for one, entry in zip(timed, entries, strict=True)
        if one is not None
    ]


def _at_goal(points: list[tuple[float, float]]) -> str:
    """The cost at an error of `GOAL`, between the points about it on logarithmic axes, or that of the first point below."""
    if not points or min(error for error, _ in points) > GOAL:
        return "not reached" if points else "not installed"
    errors, costs = np.log(np.array(sorted(points))).T
    return f"{1e6 * np.exp(np.interp(np.log(GOAL), errors, costs)):.3g}"


def _draw(found: dict[Curve, list[tuple[float, float]]]) -> None:
    figure, axes = style.sheet([["precision"]], "Error against cost", width=8.0, height=5.0)
    panel = axes["precision"]
    for curve, points in found.items():
        if points:
            error, cost = np.array(points).T
            panel.loglog(
                cost,
                error,
                curve.line,
                color=curve.colour,
                marker="o",
                markersize=4,
                label=curve.name,
            )
    panel.margins(x=0.05)
    style.finish(
        panel,
        "The paper's loop, final states",
        "largest error",
        "seconds per run and second simulated",
        legend=2,
    )
    style.write(figure, FIGURE)
