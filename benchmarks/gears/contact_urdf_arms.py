"""Arms of ten public URDF files behind gears of random gaps, with the filter of `arm --gears`.

The files are those of the package example-robot-data (`pip install example-robot-data`).
GEARS_ROBOTS: runs of each (3), GEARS_FIRST: the first seed (100), GEARS_ROWS: words of the robots
that are run (all).
"""

from __future__ import annotations

import itertools
import math
import os
import sys
import sysconfig
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import undeadzone as uz
from benchmarks.gears.contact import TOLD
from benchmarks.markdown import head, row
from undeadzone.analysis.identifiability.flanks import list_crossings
from undeadzone.errors import TrackingError
from undeadzone.feedforward.targets import flat_targets
from undeadzone.plants.robots.arm import evaluate_rows
from undeadzone.plants.robots.geared import fastest_contact
from undeadzone.plants.robots.survey import Survey, survey_urdf
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.reader import parse
from undeadzone.scenario.urdf_start import starting_scenario
from undeadzone.simulation.collect import collect
from undeadzone.simulation.simulate import prepare, signals_of

Floats = NDArray[np.float64]
FIRST = 100
HALF = (0.004, 0.02)  # of the gaps [rad]
NOISE = 3e-4  # rms of a reading [rad]
STABLE = 2.0  # largest product of a step of the plant and its fastest mode
SPANS = (0.3, 1.0)  # of a motion, which few and many gaps are crossed by [rad]
SHARE = 0.6  # of the way to a limit, and of the greatest speed
SMALLER = 0.8  # by so much is a motion reduced that the arm cannot follow, and slowed
FASTEST = 1.9  # top speed over the mean one, of a quintic from rest to rest


class Robot(NamedTuple):
    """A file of the package, and which part of it is taken.

    Attributes:
        path: of the file.
        tip: link in which the arm ends; None: there is one end.
        joints: that move; None: all of them.
        at: its posture; None: that of the file.
    """

    path: str
    tip: str | None = None
    joints: Sequence[str] | None = None
    at: Sequence[float] | None = None


ROBOTS = {name: Robot(**places) for name, places in TOLD["robots"].items()}


class Outcome(NamedTuple):
    """Result of a run.

    Attributes:
        diverged: whether it did.
        known: verdicts (joints).
        narrowed: whether a gap that is not known is in a narrower range than declared (joints).
        crossed: whether each gap was crossed in truth (joints).
        struck: whether a strike of it shows in the readings (joints).
        score: error of each gap over the deviation that is shown (joints).
        covered: whether the interval that is shown holds each gap (joints).
        tip: rms distance of the tip from its path, over that of the true state.
        tip_known: the same with the joints of unknown gaps on their paths in both runs: a gap
            that is never crossed leaves its link anywhere in it, whatever the filter. NaN if the
            joints of known gaps do not move the tip.
    """

    diverged: bool
    known: NDArray[np.bool_]
    narrowed: NDArray[np.bool_]
    crossed: NDArray[np.bool_]
    struck: NDArray[np.bool_]
    score: Floats
    covered: NDArray[np.bool_]
    tip: float
    tip_known: float


def folder() -> Path:
    """Return the folder of the package's robot files."""
    return Path(sysconfig.get_path("purelib"), "cmeel.prefix/share/example-robot-data/robots")


def motion(found: Survey, rng: np.random.Generator, span: float, part: float) -> dict[str, Any]:
    """Four random postures about the arm's, again and again."""
    low, high = np.array([joint.limits for joint in found.joints]).T
    room = SHARE * np.minimum(found.q - low, high - found.q)
    reach = part * np.minimum(span, room)
    points = [found.q, *(found.q + reach * rng.uniform(-1, 1, (4, found.q.size))), found.q]
    speeds = np.minimum([joint.velocity for joint in found.joints], 2.0)
    times = [0.0]
    for one, two in itertools.pairwise(points):
        least = float(np.max(FASTEST * np.abs(two - one) / (SHARE * speeds)))
        times.append(times[-1] + max(least, 0.6) / part)
    return {
        "kind": "quintic",
        "points": [point.tolist() for point in points],
        "times": times,
        "repeat": True,
    }


def draw_scenario(robot: Robot, seed: int) -> uz.Scenario:
    """Draw an arm and a path; the filter is that which `arm --gears` writes."""
    path = folder() / robot.path
    found = survey_urdf(path, robot.joints, robot.tip, robot.at)
    rng, N = np.random.default_rng(seed), len(found.joints)
    span = SPANS[seed % len(SPANS)]
    started = parse(starting_scenario(found, str(path), gears=True))
    gears = started.plant.arm.gears
    friction, true = np.asarray(gears.friction), {}
    drawn_ = {
        "half": rng.uniform(*HALF, N),
        "friction": friction * rng.uniform(0.5, 1.5, N),
        "contact": rng.uniform(300, 600, N),
    }
    for name, numbers in drawn_.items():
        true |= {f"{name}{k + 1}": float(value) for k, value in enumerate(numbers)}
    parameters = {f"friction{k + 1}": float(value) for k, value in enumerate(friction)}
    parameters |= {f"contact{k + 1}": 400.0 for k in range(N)}
    began = rng.bit_generator.state
    for part in SMALLER ** np.arange(10):
        rng.bit_generator.state = began
        scenario = (
            started.replace("plant.parameters", {**started.plant.parameters, **true})
            .replace("model", {"parameters": parameters})
            .replace("sensor.noise", NOISE)
            .replace("reference", motion(found, rng, span, float(part)))
            .replace("simulation.substeps", 400)
            .replace("simulation.seed", seed)
        )
        try:
            problem = resolve_scenario(scenario)
        except TrackingError:
            continue
        points = np.array(scenario.reference.points)
        fastest = 0.0
        for system in (problem.plant, problem.model):
            assert system.gears is not None
            fastest = max(fastest, fastest_contact(system.gears, system.params, points))
        steps = int(np.ceil(scenario.simulation.step * fastest / STABLE))
        return scenario.replace("simulation.substeps", max(steps, 2))
    raise SystemExit(f"{robot.path}: no motion that the motors can follow (seed {seed})")


def outcome(robot: Robot, seed: int) -> Outcome:
    """Run one arm, and the same with the true state, and return the result."""
    scenario = draw_scenario(robot, seed)
    problem = resolve_scenario(scenario)
    signal, _ = signals_of(problem, prepare(problem), None)
    run = collect(problem, signal, None, 0.0)
    exact_run = uz.simulate(scenario.replace("observer", {"method": "full_state"}))
    plant = problem.plant
    assert plant.gears is not None
    assert run.width_std is not None
    verdicts = run.info.identifiable
    known, narrowed, strikes = (
        np.array([verdict[name] for verdict in verdicts])
        for name in ("width", "narrowed", "crossings")
    )
    true = 2 * np.array(run.info.widths[::2])
    gap = run.d_hat[-1].reshape(-1, 2).sum(axis=1)
    numbers = run.summary()
    crossings = list_crossings(plant.gears, plant.params, run.x)
    assert run.rms_tip is not None
    assert exact_run.rms_tip is not None
    exact_error = tip_error(problem, exact_run, known)
    return Outcome(
        run.divergence_time is not None,
        known,
        narrowed,
        np.array([bool(each.rows.size) for each in crossings]),
        strikes > 0,
        np.abs(gap - true) / run.width_std[-1],
        (np.array(numbers["gap_low"]) <= true) & (true <= np.array(numbers["gap_high"])),
        run.rms_tip / exact_run.rms_tip,
        tip_error(problem, run, known) / exact_error if exact_error else math.nan,
    )


def tip_error(problem: Problem, run: uz.Run, known: NDArray[np.bool_]) -> float:
    """Return the rms distance of the tip from its path, joints of unknown gaps on their paths."""
    plant, model = problem.plant, problem.model
    assert plant.arm is not None
    assert problem.path is not None
    assert run.tip_r is not None
    path = flat_targets(problem.flow, problem.path, problem.tracked, run.t).x_ref
    params, true = plant.joints(plant.params, run.x.T)
    planned = model.joints(model.params, path.T)[1]
    angles = np.where(known[:, None], true, planned)
    tip = evaluate_rows(plant.arm.tip, params, angles.T)
    return float(np.sqrt(np.sum((tip - run.tip_r)[run.last] ** 2, axis=1).mean()))


def median_and_worst(ratios: list[float]) -> str:
    """Return the median of the finite ratios, and the largest in brackets."""
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    return f"{np.median(finite):.1f} ({max(finite):.1f})" if finite else ""


def line(label: str, results: list[Outcome]) -> str:
    """The row of a robot."""
    fine = [each for each in results if not each.diverged]
    known, narrowed, crossed, struck, score, covered = (
        np.concatenate([getattr(each, name) for each in fine])
        for name in ("known", "narrowed", "crossed", "struck", "score", "covered")
    )
    shown = known | narrowed
    mute = crossed & ~shown & ~struck
    held = [f"{np.mean(covered[each]):.2f}" if each.any() else "" for each in (known, narrowed)]
    return row(
        label,
        f"{len(results)} ({len(results) - len(fine)})",
        f"{known.sum()}, {narrowed.sum()}, {(crossed & ~shown & struck).sum()}, {mute.sum()}, "
        f"{(~crossed).sum()} of {known.size}",
        f"{(shown & ~crossed).sum()}",
        f"{np.max(score[shown], initial=0.0):.1f}; {(score[shown] > 4).sum()}",
        f"{held[0]}, {held[1]}, {np.mean(covered):.2f}",
        median_and_worst([each.tip for each in fine]),
        median_and_worst([each.tip_known for each in fine]),
    )


NOTE = """Gaps of 8 to 40 mrad, friction of the motors 0.5 to 1.5 times the prior mean,
contacts of 300 to 600 rad/s (model: 400), readings of 0.3 mrad, 8 s on random paths of 0.3
and of 1 rad in turn. The filter is that of `undeadzone arm --gears`. Known: as the run says.
"""
HEAD = head(
    "robot",
    "runs (diverged)",
    "gaps known, narrowed; crossed, yet neither: a strike shows, none does; not crossed",
    "known or narrowed, but not crossed",
    "known or narrowed: largest error / std; beyond 4",
    "95 % interval holds: known, narrowed, all",
    "tip / that of the true state: median (worst)",
    "the same with joints of unknown gaps on their paths",
)


def table() -> str:
    """The table; empty without the package of the files."""
    if not any((folder() / robot.path).exists() for robot in ROBOTS.values()):
        print("no files: pip install example-robot-data", file=sys.stderr)
        return ""
    count = int(os.environ.get("GEARS_ROBOTS", "3"))
    first = int(os.environ.get("GEARS_FIRST", str(FIRST)))
    words, lines, every = os.environ.get("GEARS_ROWS", ""), ["## Gears of ten robots\n", NOTE], []
    lines += HEAD
    for label, robot in ROBOTS.items():
        if words not in label:
            continue
        if not (folder() / robot.path).exists():
            lines.append(row(label, "no file: pip install example-robot-data", *[""] * 6))
            continue
        results = []
        for seed in range(first, first + count):
            results.append(outcome(robot, seed))
            print(label, seed, *results[-1], sep="; ", file=sys.stderr, flush=True)
        every += results
        lines.append(line(label, results))
        print(lines[-1], flush=True)
    if every:
        lines.append(line("all", every))
    return "\n".join([*lines, ""])
