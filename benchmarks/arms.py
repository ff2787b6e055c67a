"""Robot arms: UR5 on the lanes engine beside Pinocchio and MuJoCo, and what estimating dead zones of random widths does for the tip."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

import undeadzone as uz
from benchmarks.arm_work import MOVES, Move, draw, lanes_run, virtual_machine
from undeadzone.arrays import Floats
from undeadzone.ensemble.bands import true_width
from undeadzone.ensemble.compute import Fleet, prepare
from undeadzone.ensemble.statistics import Interval, proportion, quantile
from undeadzone.scenario import Scenario, read

EXAMPLES = Path(__file__).parents[1] / "examples"
STEPS = 100
THREADS = (1, 2)
TITLES = {
    "euler": "forward dynamics once a step (Euler)",
    "rk4": "RK4: forward dynamics four times a step",
    "follow": "RK4 and computed torque on the true state",
}
NOTE = f"""UR5, {STEPS} steps of 1 ms. The least of interleaved rounds; ours / its above 1: ours takes longer. The largest difference is
of a final state from ours. Goals of an arm's step: ours at most 0.2 of `pin.aba` called from Python, at most 2 of the loop in C++. 10^4 arms over 5 s at 1 kHz are 5e7 of them.
"""
HEAD = "| work | program | us per arm and step | ours / its | largest difference |\n|---|---|---|---|---|"
WITHIN, THIRD = 0.05, 1 / 3  # of a width; of the uncompensated error


class Entry(NamedTuple):
    """A program, or why there is none; count: arms times steps of one call."""

    label: str
    run: Callable[[], Any] | str
    count: int


def entry(label: str, make: Callable[..., Callable[[], Any]], move: Move, runs: int, **options: Any) -> Entry:
    try:
        return Entry(label, make(draw(move, runs, STEPS), **options), runs * STEPS)
    except ImportError as missing:
        return Entry(label, str(missing), 1)


def rival(label: str, name: str, function: str, move: Move, runs: int, **options: Any) -> Entry:
    def make(*given: Any, **more: Any) -> Callable[[], Any]:
        return getattr(importlib.import_module(f"benchmarks.rivals.{name}"), function)(*given, **more)

    return entry(label, make, move, runs, **options)


def rows(group: str, entries: list[Entry], rounds: int = 20, *, alike: bool = True) -> list[str]:
    """A row for each, the first being ours; alike: they compute the same final states."""
    found = [one.run() if callable(one.run) else None for one in entries]
    best = [math.inf] * len(entries)
    for _ in range(rounds):
        for i, one in enumerate(entries):
            if callable(one.run):
                began = time.perf_counter()
                one.run()
                best[i] = min(best[i], (time.perf_counter() - began) / one.count)
    lines = []
    for one, seconds, states in zip(entries, best, found, strict=True):
        cells = [f"{1e6 * seconds:.3g}", f"{best[0] / seconds:.2g}", _apart(found[0], states) if alike else ""] if callable(one.run) else [one.run, "", ""]
        lines.append(f"| {group} | {one.label} | {' | '.join(cells)} |")
    return lines


def _apart(ours: Any, its: Any) -> str:
    """The largest difference of the states of the runs that both have."""
    if its is ours or its is None:
        return ""
    runs = min(len(ours), len(its))
    return f"{np.abs(ours[:runs] - its[:runs]).max():.0e}"


def simulators(move: Move, threads: int) -> list[str]:
    """Whatever moves arms, on so many threads."""
    entries = [
        entry("**undeadzone, lanes, 1024 arms**", lanes_run, move, 1024, threads=threads),
        rival("Pinocchio, loop in C++", "pinocchio_arm", "compiled_loop", move, 64, threads=threads),
    ]
    if move != "follow":
        entries.append(rival("MuJoCo, rollout", "mujoco_arm", "prepare", move, 64, rolled=True, threads=threads))
    if threads == 1:
        entries.append(entry("**undeadzone, lanes, one arm**", lanes_run, move, 1, width=1))
        entries.append(entry("**undeadzone, CasADi's virtual machine**", virtual_machine, move, 4))
        entries.append(rival("Pinocchio, loop in Python", "pinocchio_arm", "prepare", move, 4))
    if threads == 1 and move != "follow":
        entries.append(rival("MuJoCo, mj_step from Python", "mujoco_arm", "prepare", move, 4))
    if threads == 1 and move == "euler":
        entries.append(rival("Pinocchio, pin.aba from Python, the calls alone", "pinocchio_arm", "calls", move, 1))
    return rows(f"{TITLES[move]}, {threads} thread{'s' * (threads > 1)}", entries)


def whole(fleet: Fleet, runs: int = 512) -> list[str]:
    """The ensemble's loop with all that belongs to it, beside bare dynamics."""
    short, method = fleet._replace(exogenous=fleet.exogenous[:STEPS]), _method(fleet.problem.scenario)
    numbers, given = np.arange(runs), fleet.binding.lanes(fleet.binding.draw(0, runs, fleet.layout.runs))
    label = f"**undeadzone, lanes, {runs} arms: RK4, dead zones, noise, `{method}`, controller**"
    lines = []
    for threads in THREADS:
        entries = [
            Entry(label, functools.partial(short.measure, numbers, given, threads), runs * STEPS),
            rival("Pinocchio, loop in C++, forward dynamics once a step", "pinocchio_arm", "compiled_loop", "euler", 64, threads=threads),
            rival("Pinocchio, loop in C++, RK4 and computed torque", "pinocchio_arm", "compiled_loop", "follow", 64, threads=threads),
        ]
        if threads == 1:
            entries.append(rival("Pinocchio, pin.aba from Python, the calls alone", "pinocchio_arm", "calls", "euler", 1))
            entries.append(rival("Pinocchio, loop in Python, RK4 and computed torque", "pinocchio_arm", "prepare", "follow", 4))
        lines += rows(f"whole closed loop, {threads} thread{'s' * (threads > 1)}", entries, 10, alike=False)
    return lines


class Accuracy(NamedTuple):
    """Of each run: rms error of the tip over the last 2 s [m], compensated and not; estimates and truth (runs x joints x [right, left])."""

    tip: Floats
    blind: Floats | None
    estimate: Floats
    truth: Floats


@functools.cache
def fleet(name: str, blind: bool = False) -> Fleet | None:
    """The 100 runs of an example, or of what it is compared with, None without that."""
    scenario = read(EXAMPLES / f"{name}.toml")
    scenario = msgspec.structs.replace(scenario, ensemble=msgspec.structs.replace(scenario.ensemble or uz.Vary(), runs=100))
    if blind and scenario.compare is None:
        return None
    return prepare(msgspec.structs.replace(scenario, observer=scenario.compare) if blind else scenario)


def measured(name: str) -> Accuracy:
    """The runs of an example beside its [compare], with the same widths, noise and initial states."""
    ours, other = fleet(name), fleet(name, blind=True)
    assert ours is not None
    found, blind = _columns(ours), None if other is None else _columns(other)
    varied, sensor = {words: found[words] for words in ours.binding.names}, ours.problem.sensor
    edges = [[(f"{edge}[{i}]", nominal[i]) for edge, nominal in (("right", sensor.right), ("left", sensor.left))] for i in range(ours.problem.plant.p)]
    runs = ours.layout.runs
    estimate = np.array([[found[f"d_{words}"] for words, _ in pair] for pair in edges])
    truth = np.array([[np.broadcast_to(true_width(words, nominal, varied), runs) for words, nominal in pair] for pair in edges])
    return Accuracy(_tip(found), None if blind is None else _tip(blind), estimate.transpose(2, 0, 1), truth.transpose(2, 0, 1))


def _columns(given: Fleet) -> dict[str, Floats]:
    runs = given.layout.runs
    return dict(zip(given.layout.columns, given.rows(np.arange(runs), given.binding.draw(0, runs, runs)).T, strict=True))


def _tip(found: dict[str, Floats]) -> Floats:
    return np.where(found["diverged"] != 0, np.inf, found["rms_tip"])


def tips(name: str, found: Accuracy) -> str:
    """The row of an arm."""
    scenario = read(EXAMPLES / f"{name}.toml")
    cells = [name, _method(scenario), _median(1e3 * found.tip, "{:.3g}")]
    if found.blind is None:
        return _row(*cells, "no [compare]", "", "")
    ratio = found.tip / found.blind
    return _row(*cells, _median(1e3 * found.blind, "{:.3g}"), _median(ratio, "{:.3g}"), _share(ratio <= THIRD))


def widths(name: str, found: Accuracy) -> list[str]:
    """A row for each joint: relative errors of what the readings determine."""
    info = uz.simulate(read(EXAMPLES / f"{name}.toml")).info
    lines = []
    for i, verdict in enumerate(info.identifiable):
        (right, left), (d_right, d_left) = found.estimate[:, i].T, found.truth[:, i].T
        pairs = {"width": (right + left, d_right + d_left), "right": (right, d_right), "left": (left, d_left)}
        cells = [_relative(*pair) if verdict[key] else "not identifiable" for key, pair in pairs.items()]
        lines.append(_row(name, str(i + 1), *cells, "yes" if verdict["centre"] else "no"))
    return lines


def _relative(estimate: Floats, truth: Floats) -> str:
    if not truth.all():
        return "no dead zone"
    error = np.abs(estimate / truth - 1)
    return f"{_median(100 * error, '{:.2g}')}; {_share(error <= WITHIN)}"


def _method(scenario: Scenario) -> str:
    return str(type(scenario.observer).__struct_config__.tag)


def _median(values: Floats, form: str) -> str:
    return _interval(quantile(np.sort(values), 0.5), form)


def _share(held: Any) -> str:
    return _interval(Interval(*(100 * value for value in proportion(int(held.sum()), held.size))), "{:.3g}") + " %"


def _interval(found: Interval, form: str) -> str:
    value, low, high = map(form.format, found)
    return f"{value} ({low} to {high})"


def _row(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def table() -> str:
    """Speed, then accuracy."""
    if importlib.util.find_spec("adam") is None:
        return "## Robot arms\n\nNot measured: adam-robotics is not installed.\n"
    loop = fleet("ur5")
    assert loop is not None
    speeds = [line for move in MOVES for threads in THREADS for line in simulators(move, threads)] + whole(loop)
    found = {name: measured(name) for name in ("two_link", "ur5")}
    return "\n".join(
        [
            "## Robot arms\n",
            NOTE,
            HEAD,
            *speeds,
            "\n100 arms with random widths, asymmetric, each joint its own: medians over runs and shares of runs with 95 % intervals.\n",
            "| arm | observer | rms error of the tip, last 2 s [mm] | uncompensated [mm] | their ratio | at most a third |\n|---|---|---|---|---|---|",
            *(tips(name, one) for name, one in found.items()),
            "\nRelative errors [%] of estimated widths after 20 s; runs within 5 %.\n",
            "| arm | joint | d_r + d_l | d_r | d_l | centre identifiable |\n|---|---|---|---|---|---|",
            *(line for name, one in found.items() for line in widths(name, one)),
            "",
        ]
    )
