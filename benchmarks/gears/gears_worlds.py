"""Servos behind gears that wind up, wear, spring back, or have what their model has not.

GEARS_WORLDS: loops of each world (20), GEARS_FIRST: the first seed (7000), GEARS_ROWS: words of the
worlds that are run (all), GEARS_BOUND: servos of each world of which the bound of information is
computed (0).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from benchmarks.gears.contact import (
    FRESH,
    SERVO,
    TOLD,
    Bench,
    bench,
    changed,
    driven,
    evaluate_outputs,
    geared,
    turning,
)
from benchmarks.gears.mujoco_arms import Arm, Links, Twin, servo
from benchmarks.markdown import head, row
from undeadzone.util import tree

Floats = NDArray[np.float64]
SHEET, TRUSTED = 0.2, 0.3
STRIBECK = 0.05  # speed at which friction has fallen from rest [rad/s]
DRAWS = 400  # machines, whose numbers show how they spread
STEP = 0.01  # of a difference, over that spread


class World(NamedTuple):
    """Differences between machine and model.

    Attributes:
        offset: largest error of the encoder's zero [rad].
        eccentric: range of the amplitude of a wave of eight a turn [rad].
        payload: range of what is added half way through, over the mass of the link.
        sticks: friction of the motor at rest, over that in motion.
        masses, rotor: by what shares those of the model may be off.
        winds: range of the wind-up under the torque that holds the link level [rad].
        springs: range of the torque of a return spring at 0.5 rad, over that same torque.
        wears: share by which the gap has grown at the end.
        sides: friction of the motor, over its mean, as it turns right and left.
        oil: range of the viscous drag in the gap [N m s/rad].
        unknown: what the filter is told of them, `observer.unknown`. Of a spring it is told a
            datasheet's numbers, up to `SHEET` off, and a range of `TRUSTED` about them.
    """

    offset: float = 0.0
    eccentric: tuple[float, float] = (0.0, 0.0)
    payload: tuple[float, float] = (0.0, 0.0)
    sticks: float = 1.0
    masses: float = 0.0
    rotor: float = 0.0
    winds: tuple[float, float] = (0.0, 0.0)
    springs: tuple[float, float] = (0.0, 0.0)
    wears: float = 0.0
    sides: tuple[float, float] = (1.0, 1.0)
    oil: tuple[float, float] = (0.0, 0.0)
    unknown: Mapping[str, Sequence[float]] = {}


WORLDS = {name: World(**numbers) for name, numbers in TOLD["worlds"].items()}
for name, numbers in TOLD[
    "further"
].items():  # what the model has not, without and with a range for it
    world = World(**numbers)
    WORLDS |= {f"{name}, not told": world._replace(unknown={}), f"{name}, told": world}


class Machine(NamedTuple):
    """A servo in a world.

    Attributes:
        arm: its numbers.
        offset: of the encoder's zero [rad].
        wave: amplitude [rad] and phase of its eccentricity.
        added: to the payload half way through [kg].
        spring: its torque at 0.5 rad [N m].
        world: in which it is.
    """

    arm: Arm
    offset: float
    wave: tuple[float, float]
    added: float
    spring: float
    world: World


def draw(world: World, rng: np.random.Generator) -> Machine:
    """A random servo in a world."""
    arm = servo(rng)
    assert isinstance(arm.links, Links)
    off = 1 + world.masses * rng.choice([-1.0, 1.0])
    links = arm.links._replace(mass=arm.links.mass * off, inertia=arm.links.inertia * off)
    rotor = arm.rotor * (1 + world.rotor * rng.choice([-1.0, 1.0]))
    offset = world.offset * float(rng.uniform(-1, 1))
    wave = float(rng.uniform(*world.eccentric)), float(rng.uniform(0, 2 * np.pi))
    added = float(rng.uniform(*world.payload)) * float(arm.links.mass[0])
    level = 9.81 * (links.mass * links.centre + arm.payload * links.length)
    winds, springs, oil = (
        float(rng.uniform(*each)) for each in (world.winds, world.springs, world.oil)
    )
    arm = arm._replace(links=links, rotor=rotor, payload=max(arm.payload, 1e-3), oil=oil)
    if winds:
        arm = arm._replace(belt=level / winds)
    return Machine(arm, offset, wave, added, springs * float(level[0]), world)


def shown(machine: Machine, twin: Twin, k: int, count: int) -> Floats:
    """The state of a servo by its encoder, after what its world does to it in a sample."""
    arm, world = machine.arm, machine.world
    if k == count // 2 and machine.added:
        twin.load(arm.payload + machine.added)
    state = twin.state()
    share = np.exp(-((float(state[2]) / STRIBECK) ** 2))
    side = world.sides[int(state[2] < 0)]
    twin.rub(float(arm.motor_friction[0]) * side * (1 + (world.sticks - 1) * share))
    if world.wears:
        twin.wear(arm.half * (1 + world.wears * k / count))
    if machine.spring:
        turned = (state[1:2] + np.pi / 2) / 0.5
        twin.pull(-machine.spring * (turned + turned**3) / 2)
    amplitude, phase = machine.wave
    state[0] += machine.offset + amplitude * np.sin(8 * state[0] + phase)
    return state


def scenario() -> dict[str, Any]:
    """The hanging servo of `benchmarks.gears`."""
    hanging = {**SERVO, "reference": turning(-1.5708, 0.5, 2.0, 9.0)}
    return changed(hanging, simulation={"duration": 8.5})


def told(machine: Machine, seed: int) -> dict[str, Any]:
    """What the filter is told of a machine."""
    gears, unknown = {}, dict(machine.world.unknown)
    sheet = machine.spring * np.random.default_rng(seed).uniform(1 - SHEET, 1 + SHEET)
    for name in {"spring", "hardening"} & {*unknown}:
        gears |= {"spring_at": -np.pi / 2, name: sheet * unknown[name][0]}
        unknown[name] = [gears[name] * (1 - TRUSTED), gears[name] * (1 + TRUSTED)]
    return changed(geared(scenario(), **gears), observer={"unknown": unknown})


def least_deviations(machine: Machine, setup: Bench, u: Floats, seed: int) -> Floats:
    """The least deviations of a gap over the gap: by a log alone, and with all else told.

    It is the bound of Cramér and Rao with a prior, to which MuJoCo is the model: what the readings
    of an encoder show under the torques of a log (M x 1) [N m], at the numbers of a machine, which
    spread as `draw` has it (van Trees 1968, doi:10.1002/0471221082, section 2.4).
    """
    world, step = machine.world, setup.problem.scenario.simulation.step

    def numbers(one: Machine) -> dict[str, Any]:
        return dict(tree.iterate_leaves(one._replace(world=None)))

    def readings(values: Mapping[str, Any]) -> Floats:
        one = tree.rebuild_tree(machine._replace(world=None), iter(values.values()))
        one, angles = one._replace(world=world), []
        flank = np.random.default_rng(seed).choice([-1.0, 1.0], 1)
        twin = Twin(one.arm, setup.problem.x0[1:2], flank)
        for k, torque in enumerate(u):
            angles.append(shown(one, twin, k, len(u))[0])
            twin.move(torque, step)
        return np.array(angles)

    others = [numbers(draw(world, np.random.default_rng(k))) for k in range(DRAWS)]
    spread = {name: np.std([each[name] for each in others]) for name in others[0]}
    here = numbers(machine)
    base, slopes = readings(here), {}
    for name in [name for name, std in spread.items() if std > 0]:
        moved = readings(here | {name: here[name] + STEP * spread[name]})
        slopes[name] = (moved - base) / (STEP * setup.problem.sensor.rms[0])
    each = np.array([*slopes.values()])
    information = each @ each.T + np.eye(len(each))
    gap = [*slopes].index("arm.half")
    variances = [np.linalg.inv(information)[gap, gap], 1 / information[gap, gap]]
    std: Floats = np.sqrt(variances) * spread["arm.half"] / machine.arm.half
    return std


def share_near(std: Floats) -> Floats:
    """The share within 5 % of errors of such deviations over the gap, mean over the first axis."""
    shares: Floats = np.mean(erf(0.05 / np.sqrt(2) / std), axis=0)
    return shares


def line(label: str, world: World, count: int, first: int) -> str:
    """The row of a world."""
    results, least = [], []
    for seed in range(first, first + count):
        machine = draw(world, np.random.default_rng(seed))
        setup = bench(told(machine, seed))
        outputs = driven(setup, machine.arm, seed, partial(shown, machine))
        if len(least) < int(os.environ.get("GEARS_BOUND", "0")):
            u = outputs[:, tree.leaf_slices(setup.loop.outputs).u]
            least.append(least_deviations(machine, setup, u, seed))
        worn = machine.arm._replace(half=machine.arm.half * (1 + world.wears))
        results.append(evaluate_outputs(setup, worn, outputs))
    fine = [each for each in results if not each.diverged]
    covered = np.array([each.covered for each in fine])
    error = np.abs(np.array([each.half for each in fine]) - 1)
    near = [f"{np.mean(error <= share):.2f}" for share in (0.05, 0.1)]
    score = np.abs(np.array([each.score for each in fine]))
    claimed = error / score  # deviations over the gaps
    silent = sum(one.is_lost() and not one.warned for one in fine)
    known = ""
    if least:
        bounds = zip(share_near(np.array(least)), 100 * np.median(least, axis=0), strict=True)
        known = "; ".join(f"{share:.2f} ({std:.2g} %)" for share, std in bounds)
    return row(
        label,
        f"{len(results)} ({len(results) - len(fine)})",
        f"{covered.mean():.2f} ({covered.min():.2f})",
        f"{1e3 * np.median([each.estimated for each in fine]):.2f}",
        f"{100 * np.median(error):.1f} %, {', '.join(near)}; {share_near(claimed.ravel()):.2f}",
        known,
        f"{np.mean(score <= 1.96):.2f}; {np.mean(score**2):.2f}",
        f"{sum(each.warned for each in fine)}; {silent}",
    )


NOTE = """A servo each that MuJoCo moves (`benchmarks/gears/gears_worlds.py`), as in "Gears
as they are"; the last 4 s of 8.5 s. The payload changes after 4.25 s. Lost without a word: a gap
beyond 5 std, or a link outside of its interval in half of the samples, with `consistent` 1 in the
last 200 samples.
"""
HEAD = head(
    "world",
    "servos (diverged)",
    "95 % interval of the link holds: mean (least)",
    "link^: median rms [mrad]",
    "gap's error: median, shares within 5 and 10 %; within 5 % by its own deviations",
    "by the bound of information (its median deviation): of a log alone; all else told",
    "95 % interval of the gap holds; mean square of errors over deviations",
    "flagged; lost without a word",
)


def table() -> str:
    """The table."""
    count = int(os.environ.get("GEARS_WORLDS", "20"))
    first = int(os.environ.get("GEARS_FIRST", str(FRESH)))
    lines = ["## Encoders as they are\n", NOTE, *HEAD]
    words = os.environ.get("GEARS_ROWS", "")
    for label, world in WORLDS.items():
        if words not in label:
            continue
        lines.append(line(label, world, count, first))
        print(lines[-1], flush=True)
    return "\n".join([*lines, ""])
