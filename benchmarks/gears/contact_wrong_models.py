"""Servos behind gears whose encoders, payloads and frictions are not those of the model.

GEARS_WORLDS: loops of each world (20), GEARS_FIRST: the first seed (7000), GEARS_CENTRE: the
claimed deviation of an encoder's zero [rad] (the default of `contact`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.gears.contact import (
    FRESH,
    SERVO,
    Bench,
    bench,
    changed,
    outcome,
    turning,
)
from benchmarks.gears.mujoco_arms import Arm, Links, Twin, servo
from benchmarks.markdown import head, row

Floats = NDArray[np.float64]
STRIBECK = 0.05  # speed at which friction has fallen from rest [rad/s]


class World(NamedTuple):
    """Differences between machine and model.

    Attributes:
        offset: largest error of the encoder's zero [rad].
        eccentric: range of the amplitude of a wave of eight a turn [rad].
        payload: range of what is added half way through, over the mass of the link.
        sticks: friction of the motor at rest, over that in motion.
        masses, rotor: by what shares those of the model may be off.
    """

    offset: float = 0.0
    eccentric: tuple[float, float] = (0.0, 0.0)
    payload: tuple[float, float] = (0.0, 0.0)
    sticks: float = 1.0
    masses: float = 0.0
    rotor: float = 0.0


WORLDS = {
    "plain": World(),
    "zero off by up to 5 mrad": World(offset=5e-3),
    "eccentric, 0.5 to 2 mrad": World(eccentric=(5e-4, 2e-3)),
    "payload + 0.2 to 0.5 of the link": World(payload=(0.2, 0.5)),
    "Stribeck friction": World(sticks=1.5),
    "all of these": World(5e-3, (5e-4, 2e-3), (0.2, 0.5), 1.5),
    "all, with Stribeck friction, masses 5 % and rotor 10 % off": World(
        5e-3, (5e-4, 2e-3), (0.2, 0.5), 1.5, 0.05, 0.1
    ),
}


class Machine(NamedTuple):
    """A servo in a world.

    Attributes:
        arm: its numbers.
        offset: of the encoder's zero [rad].
        wave: amplitude [rad] and phase of its eccentricity.
        added: to the payload half way through [kg].
        sticks: as of its world.
    """

    arm: Arm
    offset: float
    wave: tuple[float, float]
    added: float
    sticks: float


def draw(world: World, rng: np.random.Generator) -> Machine:
    """A random servo in a world."""
    arm = servo(rng)
    assert isinstance(arm.links, Links)
    off = 1 + world.masses * rng.choice([-1.0, 1.0])
    links = arm.links._replace(mass=arm.links.mass * off, inertia=arm.links.inertia * off)
    rotor = arm.rotor * (1 + world.rotor * rng.choice([-1.0, 1.0]))
    return Machine(
        arm._replace(links=links, rotor=rotor, payload=max(arm.payload, 1e-3)),
        world.offset * float(rng.uniform(-1, 1)),
        (float(rng.uniform(*world.eccentric)), float(rng.uniform(0, 2 * np.pi))),
        float(rng.uniform(*world.payload)) * float(arm.links.mass[0]),
        world.sticks,
    )


def shown(machine: Machine, twin: Twin, k: int, count: int) -> Floats:
    """The state of a servo by its encoder; half way its payload grows, and its friction varies."""
    if k == count // 2 and machine.added:
        twin.load(machine.arm.payload + machine.added)
    state = twin.state()
    share = np.exp(-((float(state[2]) / STRIBECK) ** 2))
    twin.rub(float(machine.arm.motor_friction[0]) * (1 + (machine.sticks - 1) * share))
    amplitude, phase = machine.wave
    state[0] += machine.offset + amplitude * np.sin(8 * state[0] + phase)
    return state


def scenario() -> Mapping[str, Any]:
    """The hanging servo of `benchmarks.gears`."""
    hanging = {**SERVO, "reference": turning(-1.5708, 0.5, 2.0, 9.0)}
    hanging = changed(hanging, simulation={"duration": 8.5})
    centre = os.environ.get("GEARS_CENTRE")
    return changed(hanging, observer={"centre": float(centre)}) if centre else hanging


def line(label: str, setup: Bench, world: World, count: int, first: int) -> str:
    """The row of a world."""
    results = []
    for seed in range(first, first + count):
        machine = draw(world, np.random.default_rng(seed))
        results.append(outcome(setup, machine.arm, seed, partial(shown, machine)))
    fine = [each for each in results if not each.diverged]
    covered = np.array([each.covered for each in fine])
    error = np.abs(np.array([each.half for each in fine]) - 1)
    score = np.abs(np.array([each.score for each in fine]))
    silent = sum(one.is_lost() and not one.warned for one in fine)
    return row(
        label,
        f"{len(results)} ({len(results) - len(fine)})",
        f"{covered.mean():.2f} ({covered.min():.2f})",
        f"{1e3 * np.median([each.estimated for each in fine]):.2f}",
        f"{100 * np.median(error):.1f} %, {np.mean(error <= 0.05):.2f}",
        f"{np.mean(score <= 1.96):.2f}",
        f"{sum(each.warned for each in fine)}; {silent}",
    )


NOTE = """A servo each that MuJoCo moves (`benchmarks/gears/contact_wrong_models.py`), as in "Gears
as they are"; the last 4 s of 8.5 s. The payload changes after 4.25 s. Lost without a word: a gap
beyond 5 std, or a link outside of its interval in half of the samples, with `consistent` 1 in the
last 200 samples.
"""
HEAD = head(
    "world",
    "servos (diverged)",
    "95 % interval of the link holds: mean (least)",
    "link^: median rms [mrad]",
    "gap's error: median, share within 5 %",
    "95 % interval of the gap holds",
    "flagged; lost without a word",
)


def table() -> str:
    """The table."""
    count = int(os.environ.get("GEARS_WORLDS", "20"))
    first = int(os.environ.get("GEARS_FIRST", str(FRESH)))
    setup, lines = bench(scenario()), ["## Encoders as they are\n", NOTE, *HEAD]
    for label, world in WORLDS.items():
        lines.append(line(label, setup, world, count, first))
        print(lines[-1], flush=True)
    return "\n".join([*lines, ""])
