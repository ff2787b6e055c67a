"""Arms and servos behind gears that MuJoCo moves: links, gaps and paths by `contact`.

GEARS_SECONDS: CPU time a row may take (600), GEARS_FIRST: the first seed, GEARS_ROWS: words of the
rows that are run (all). What loops a row had is said in the table.
"""

from __future__ import annotations

import os
import time
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.gears.mujoco_arms import UR5, Arm, Twin, servo, two_link, ur5
from benchmarks.markdown import head, row
from benchmarks.results import commit
from benchmarks.timing import least
from undeadzone.compile.scalar_step import CompiledStepper
from undeadzone.plants.robots.arm import evaluate_rows
from undeadzone.scenario.problem import Problem, resolve_scenario
from undeadzone.scenario.reader import convert
from undeadzone.simulation.close import close
from undeadzone.simulation.exogenous import exogenous
from undeadzone.simulation.loop import Loop
from undeadzone.util import tree

Floats = NDArray[np.float64]
FRESH = 7000  # first seed; those below 100 were used while the filter was made
LOOPS = 100
LAST = 4.0  # time at the end over which errors are taken [s]
AWAY = 1.5  # error of a joint beyond which a loop has diverged [rad]

TOLD = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
SERVO, ARM, SIX = (TOLD[name] for name in ("servo", "two_links", "six_joints"))
SIX["plant"]["arm"]["path"] = str(UR5)


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        label: what is run.
        scenario: what observer and controller are told.
        draw: an arm from random numbers.
    """

    label: str
    scenario: Mapping[str, Any]
    draw: Callable[[np.random.Generator], Arm]


def changed(scenario: Mapping[str, Any], **changes: Any) -> dict[str, Any]:
    """A scenario with other entries in some tables, one level deep."""
    tables = dict(scenario)
    for name, entries in changes.items():
        tables[name] = {**tables.get(name, {}), **entries}
    return tables


def geared(scenario: Mapping[str, Any], **changes: Any) -> dict[str, Any]:
    """A scenario with other entries of the gears."""
    arm = scenario["plant"]["arm"]
    gears = {**arm["gears"], **changes}
    return changed(scenario, plant={"arm": {**arm, "gears": gears}})


def turning(middle: float, swing: float, period: float, duration: float) -> dict[str, Any]:
    """A joint that turns to and fro."""
    count = int(2 * duration / period) + 2
    points = [[middle], *([middle + swing * (-1.0) ** k] for k in range(count))]
    times = [0.0, *(period / 2 * (k + 0.7) for k in range(count))]
    return {"kind": "quintic", "points": points, "times": times}


def rows() -> list[Row]:
    """Every row, in the order of the table."""
    hanging = {**SERVO, "reference": turning(-1.5708, 0.5, 2.0, 7.0)}
    level = {**SERVO, "reference": turning(0.0, 0.5, 2.0, 7.0)}
    flat = changed(level, plant={"parameters": {**SERVO["plant"]["parameters"], "g": 0.0}})
    flat = changed(flat, plant={"x0": [0.0, 0.0]})
    resting = {**SERVO, "reference": turning(-0.6, 0.4, 2.5, 7.0)}
    resting = changed(resting, plant={"x0": [-0.6, 0.0]})
    slow = changed(hanging, simulation={"step": 5e-3, "substeps": 3})
    coarse = changed(hanging, sensor={"noise": 0.0, "quantum": 0.001534})
    swung = changed(ARM, reference={"swing": TOLD["swing"]})
    ignored = changed(swung, observer={"half": [0.0, 1e-4]})
    heavy = {"m1": 3.3, "m2": 2.2, "I1": 0.044, "I2": 0.0165}
    parameters = {**ARM["plant"]["parameters"], **heavy}
    rubbing = {"friction": [0.15, 0.05]}
    six_ignored = geared(changed(SIX, observer={"half": [0.0, 1e-4]}), half=1e-5)
    apart = changed(swung, observer={"joints": "separate"})
    return [
        Row("six joints, swings then figure eight", SIX, ur5),
        Row("six joints, gears ignored", six_ignored, ur5),
        Row("two links, joint by joint", apart, two_link),
        Row("two links, swings then figure eight", swung, two_link),
        Row("the same, gears ignored", geared(ignored, half=1e-5), two_link),
        Row("figure eight alone", ARM, two_link),
        Row("two links, contact told 4 times too slow", geared(swung, contact=137.0), two_link),
        Row("two links, friction told at half", geared(swung, **rubbing), two_link),
        Row(
            "two links, masses told 10 % too large",
            changed(swung, plant={"parameters": parameters}),
            two_link,
        ),
        Row("servo, motor encoder", hanging, servo),
        Row("servo, 12-bit motor encoder", coarse, servo),
        Row("servo, horizontal", flat, lambda rng: servo(rng, gravity=0.0)),
        Row("servo, 200 Hz", slow, servo),
        Row("servo, held on a flank", resting, servo),
        Row("servo, both encoders", geared(hanging, measured="both"), servo),
        Row("servo, link encoder", geared(hanging, measured="link"), servo),
    ]


class Bench(NamedTuple):
    """A loop whose plant is written in from outside, sample by sample.

    Attributes:
        problem: what observer and controller are told.
        loop: the closed loop.
        stepper: one sample of it.
        start: its state at first.
        inputs: exogenous ones without noise.
    """

    problem: Problem
    loop: Loop
    stepper: CompiledStepper
    start: Floats


def bench(scenario: Mapping[str, Any]) -> Bench:
    """The loop of a scenario, compiled."""
    problem = resolve_scenario(convert({"title": "gears", **scenario}))
    loop = close(problem)
    start = tree.pack_tree(loop.state._replace(plant=problem.x0))
    return Bench(
        problem, loop, CompiledStepper(loop.step, start, tree.pack_tree(loop.params)), start
    )


class Outcome(NamedTuple):
    """What became of a loop.

    Attributes:
        diverged: whether a joint was off by more than `AWAY`.
        path: rms of tip (or angle) from its path [m or rad].
        estimated: rms of the estimated tip (or angle) from the true one.
        half: estimated half gaps over the true ones (N).
        score: their error over the deviation claimed (N).
        width: deviation claimed over that of the prior (N).
        covered: share of samples in which the 95 % interval holds the link's angle.
        warned: whether `consistent` was 0 in some of the last samples.
    """

    diverged: bool
    path: float = np.nan
    estimated: float = np.nan
    half: Floats = np.full(1, np.nan)
    score: Floats = np.full(1, np.nan)
    width: Floats = np.full(1, np.nan)
    covered: float = np.nan
    warned: bool = False

    def is_lost(self) -> bool:
        """Whether a gap or the link's angle is far outside of what is claimed."""
        return bool((np.abs(self.score) > 5).any() or self.covered < 0.5)


def as_it_moves(twin: Twin, k: int, count: int) -> Floats:
    """The state of an arm, which its encoders show."""
    return twin.state()


Shown = Callable[[Twin, int, int], Floats]
"""(arm, sample, samples in all) -> state of motors and links as encoders show it."""


def driven(setup: Bench, arm: Arm, seed: int, shown: Shown = as_it_moves) -> Floats:
    """The outputs of a loop around MuJoCo's arm, to the first that are no numbers.

    Args:
        setup: the loop.
        arm: its numbers.
        seed: of noise and of the flanks where it starts.
        shown: what its encoders show; it may change the arm.
    """
    problem, stepper = setup.problem, setup.stepper
    N, Ts = len(arm.half), problem.scenario.simulation.step
    where = tree.leaf_slices(setup.loop.outputs)
    inputs = exogenous(problem, seed=seed)
    rng = np.random.default_rng(seed)
    twin = Twin(arm, problem.x0[N : 2 * N], rng.choice([-1.0, 1.0], N))
    stepper.state[:] = setup.start
    outputs = np.empty((len(inputs), stepper.out.size))
    for k, instant in enumerate(inputs):
        stepper.state[: 4 * N] = shown(twin, k, len(inputs))
        stepper.w[:] = instant
        stepper()
        outputs[k] = stepper.out
        if not np.isfinite(stepper.out).all():
            return outputs[: k + 1]
        twin.move(stepper.out[where.u], Ts)
    return outputs


def outcome(setup: Bench, arm: Arm, seed: int, shown: Shown = as_it_moves) -> Outcome:
    """What becomes of one loop around MuJoCo's arm; the arguments are those of `driven`."""
    outputs = driven(setup, arm, seed, shown)
    return evaluate_outputs(setup, arm, outputs)


def evaluate_outputs(setup: Bench, arm: Arm, outputs: Floats) -> Outcome:
    """Return the outcome of a loop by its outputs."""
    if not np.isfinite(outputs[-1]).all():
        return Outcome(True)
    problem, where = setup.problem, tree.leaf_slices(setup.loop.outputs)
    N, Ts = len(arm.half), problem.scenario.simulation.step
    assert problem.path is not None
    last = outputs[-round(LAST / Ts) :]
    t = np.arange(len(outputs)) * Ts
    reference = problem.path.output_at(t, 0)[-len(last) :]
    link, estimate = last[:, where.x][:, N : 2 * N], last[:, where.estimate.x][:, N : 2 * N]
    if np.abs(outputs[:, where.x][:, N : 2 * N] - problem.path.output_at(t, 0)).max() > AWAY:
        return Outcome(True)
    std = last[:, where.estimate.x_std][:, N : 2 * N]
    end, first = outputs[-1], outputs[0]
    half = (end[where.estimate.right][:N] + end[where.estimate.left][:N]) / 2
    deviation = end[where.estimate.width_std][:N] / 2
    body = problem.model.arm

    def rms(a: Floats, b: Floats) -> float:
        if N == 1 or body is None or problem.model.gears is None:
            return float(np.sqrt(np.mean((a - b) ** 2)))
        params = problem.model.gears.link_params(problem.model.params)
        tips = evaluate_rows(body.tip, params, a) - evaluate_rows(body.tip, params, b)
        return float(np.sqrt(np.mean(np.sum(tips**2, axis=1))))

    return Outcome(
        diverged=False,
        path=rms(link, reference),
        estimated=rms(link, estimate),
        half=half / arm.half,
        score=(half - arm.half) / deviation,
        width=deviation / (first[where.estimate.width_std][:N] / 2),
        covered=float(np.mean(np.abs(link - estimate) <= 1.96 * std)),
        warned=bool((outputs[-200:, where.estimate.consistent] == 0).any()),
    )


def effort(one: Row, setup: Bench) -> str:
    """What a sample of the whole loop takes, plant and controller included."""
    steps = 200

    def run() -> None:
        for _ in range(steps):
            setup.stepper()

    setup.stepper.state[:] = setup.start
    each = least({"step": run}, 10)["step"] / steps
    count = setup.loop.step.n_instructions()
    return f"{one.label}: {count} operations a sample, {1e6 * each:.0f} us."


def line(one: Row, setup: Bench, seconds: float, first: int) -> str:
    """The row of the table; loops are run as long as their time allows."""
    began, results = time.process_time(), []
    while len(results) < LOOPS and time.process_time() - began < seconds:
        seed = first + len(results)
        results.append(outcome(setup, one.draw(np.random.default_rng(seed)), seed))
    return format_outcomes(one.label, results, len(np.atleast_1d(results[0].half)))


def format_outcomes(label: str, results: list[Outcome], N: int) -> str:
    """A row in numbers."""
    fine = [each for each in results if not each.diverged]
    diverged = len(results) - len(fine)
    if not fine:
        return row(label, str(len(results)), str(diverged), *[""] * 9)
    path = 1e3 * np.array([each.path for each in fine])
    link_errors = 1e3 * np.array([each.estimated for each in fine])
    error = np.abs(np.array([each.half for each in fine]) - 1)
    score = np.abs(np.array([each.score for each in fine]))
    silent = [each for each in fine if each.is_lost() and not each.warned]
    warned = sum(each.warned for each in fine)
    return row(
        label,
        str(len(results)),
        str(diverged),
        f"{np.median(path):.2f} ({np.quantile(path, 0.95):.2f}, {path.max():.2f})",
        f"{np.median(link_errors):.2f} ({np.quantile(link_errors, 0.95):.2f})",
        f"{np.mean(error <= 0.05):.2f}, {np.mean(error <= 0.1):.2f}",
        f"{100 * np.median(error):.1f} %",
        f"{np.mean(score <= 1.96):.3f}",
        f"{(score > 5).sum()}",
        f"{np.median([each.width for each in fine]):.2f}",
        f"{np.mean([each.covered for each in fine]):.3f}",
        f"{warned}; {len(silent)}",
    )


NOTE = """MuJoCo 4 moves the arms (`benchmarks/gears/mujoco_arms.py`); gaps, payload, friction and
contact are drawn anew for each seed and not told. The last 4 s of 9 s (two links), of 14.2 s (six
joints: a UR5, joint by joint), of 6.5 s (servos).
Path: tip of arms [mm], angle of servos [mrad]. Lost without a word: beyond 5 std, or a link's angle
outside of its interval in half of the samples, with `consistent` 1 in the last 200 samples.
"""
HEAD = head(
    "loop",
    "loops",
    "diverged",
    "from its path: median (95 %, worst)",
    "link^: median (95 %)",
    "gaps within 5 %, 10 %",
    "gap's error, median",
    "95 % interval of the gap holds",
    "beyond 5 std",
    "std over the prior's",
    "95 % interval of the link holds",
    "flagged; lost without a word",
)


def table() -> str:
    """The table."""
    seconds = float(os.environ.get("GEARS_SECONDS", "600"))
    first = int(os.environ.get("GEARS_FIRST", str(FRESH)))
    words = os.environ.get("GEARS_ROWS", "")
    chosen = [one for one in rows() if words in one.label]
    lines = ["## Gears as they are\n", f"At {commit()}. {NOTE}", *HEAD]
    efforts = []
    for one in chosen:
        setup = bench(one.scenario)
        lines.append(line(one, setup, seconds, first))
        efforts.append(effort(one, setup))
        print(lines[-1], efforts[-1], sep="\n", flush=True)
    return "\n".join([*lines, "", *efforts, ""])
