"""Error against cost over steps and tolerances: the paper's loop, 10 s, final states."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.engine import lanes_engine, rivals
from benchmarks.engine.speed import Entry, race
from benchmarks.engine.work.paper_loop import Result, Work, draw, final_error
from benchmarks.markdown import head, row
from undeadzone.report import ink, style

FIGURE = Path(__file__).parents[1] / "precision.png"
DURATION = 10.0  # [s]
STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)  # [s]
LONG_STEPS = (40e-3, 20e-3, 10e-3)  # [s]
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
RUNS = 1024
GOAL = 1e-9

Make = Callable[[Work, float], Callable[[], Result] | None]


class Curve(NamedTuple):
    """A program over its settings.

    Attributes:
        name: of the program
        make: makes it ready for some work and a setting
        work: for a setting
        settings: steps [s] or tolerances
        colour, line: its look
    """

    name: str
    make: Make
    work: Callable[[float], Work]
    settings: tuple[float, ...]
    colour: str
    line: str


def curves() -> list[Curve]:
    """Every program, ours first."""
    many, one = _stepped(RUNS), _stepped(1)
    same_many, same_64, same_one = _same(RUNS), _same(64), _same(1)
    blue, pink, grey, red = ink.ESTIMATE, ink.OTHER, ink.ZONE, ink.PRINTED
    green, orange = ink.REFERENCE, ink.READING
    heyoka, batches = _rival("heyoka_events", "tol"), _rival("heyoka_events", "tol", batch=True)
    diffrax, scipy = _rival("diffrax_tsit5", "rtol"), _rival("scipy_ivp", "rtol")
    dop853 = _rival("scipy_ivp", "rtol", method="DOP853", events=True)
    of_many, some, events = f"{RUNS} runs", TOLERANCES[1:3], TOLERANCES[:4]
    return [
        Curve(f"undeadzone, {of_many}", _ours(), many, STEPS, blue, "-"),
        Curve("undeadzone, one run", _ours(width=1), one, STEPS, blue, "--"),
        Curve(f"undeadzone, Taylor 8, {of_many}", _ours(order=8), many, LONG_STEPS, pink, "-"),
        Curve(
            "undeadzone, Taylor 8, one run", _ours(order=8, width=1), one, LONG_STEPS, pink, "--"
        ),
        Curve(f"undeadzone, plain RK4, {of_many}", _ours(step="plain"), many, STEPS, grey, "-"),
        Curve(f"heyoka, events, {of_many} in batches", batches, same_many, TOLERANCES, red, "-"),
        Curve("heyoka, events, one run", heyoka, same_one, TOLERANCES, red, "--"),
        Curve("diffrax, Tsit5, 64 runs", diffrax, same_64, some, green, "-"),
        Curve("SciPy, RK45, one run", scipy, same_one, TOLERANCES[:2], pink, "--"),
        Curve("SciPy, DOP853, events, one run", dop853, same_one, events, orange, "--"),
    ]


def _stepped(runs: int) -> Callable[[float], Work]:
    """The work of so many runs with a given step [s]."""
    return lambda step: _final(draw(runs, DURATION, step=step))


def _same(runs: int) -> Callable[[float], Work]:
    """The work of so many runs, the same for every tolerance."""
    return lambda tolerance: _final(draw(runs, DURATION))


def _final(work: Work) -> Work:
    """The work with a rms over one step only: final states are what counts here."""
    return work._replace(tail=1)


def _ours(**options: Any) -> Make:
    """Our program; the work has the step."""
    return lambda work, step: lanes_engine.prepare(work, **options)


def _rival(name: str, tolerance: str, **options: Any) -> Make:
    """A rival; tolerance: what it calls its setting."""
    return lambda work, value: rivals.prepare(name, work, **{tolerance: value}, **options)


def table(rounds: int = 5) -> str:
    """The error and cost of each, and the cost at an error of `GOAL`."""
    points = {curve: _points(curve, rounds) for curve in curves()}
    _draw(points)
    costs = "largest error: us per run and second simulated"
    lines = [
        "## Precision\n",
        f"![error against cost]({FIGURE.name})\n",
        *head("program", costs, f"us at {GOAL:g}"),
    ]
    for curve, each in points.items():
        cells = [f"{error:.0e}: {1e6 * cost:.3g}" for error, cost in each]
        lines.append(row(curve.name, ", ".join(cells), _at_goal(each)))
    return "\n".join([*lines, ""])


def _points(curve: Curve, rounds: int) -> list[tuple[float, float]]:
    """(largest error of a final state, seconds per run and second simulated) for each setting.

    None where the program is not installed.
    """
    entries = []
    for setting in curve.settings:
        work = curve.work(setting)
        entries.append(Entry(curve.name, curve.make(work, setting), work))
    points = []
    for entry, timed in zip(entries, race(entries, rounds, final_error), strict=True):
        if timed is not None:
            points.append((timed.error, timed.seconds / entry.work.step))
    return points


def _at_goal(points: list[tuple[float, float]]) -> str:
    """The cost at an error of `GOAL`.

    Between the points about it on logarithmic axes, or that of the first point below.
    """
    if not points:
        return "not installed"
    if min(error for error, _ in points) > GOAL:
        return "not reached"
    errors, costs = np.log(np.array(sorted(points))).T
    return f"{1e6 * np.exp(np.interp(np.log(GOAL), errors, costs)):.3g}"


def _draw(points: dict[Curve, list[tuple[float, float]]]) -> None:
    """Write the figure."""
    figure, axes = style.create_panels([["precision"]], "Error against cost", width=8.0, height=5.0)
    panel = axes["precision"]
    for curve, each in points.items():
        if each:
            error, cost = np.array(each).T
            look: Any = {"color": curve.colour, "marker": "o", "markersize": 4}
            panel.loglog(cost, error, curve.line, label=curve.name, **look)
    panel.margins(x=0.05)
    title, x_label = "The paper's loop, final states", "seconds per run and second simulated"
    style.finish_panel(panel, title, "largest error", x_label, legend=2)
    style.write_figure(figure, FIGURE)
