"""A scenario to start from for an arm of a URDF file, ready to run and to change."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from undeadzone.errors import InputError
from undeadzone.observers.contact import MOST_COUPLED
from undeadzone.plants.robots.geared import Gears, build_geared_arm, fastest_contact
from undeadzone.plants.robots.survey import Survey
from undeadzone.plants.robots.urdf_elements import Joint
from undeadzone.util.arrays import Floats
from undeadzone.util.text import escape_json_controls, fill_words

SWING = {"revolute": 0.3, "continuous": 0.3, "prismatic": 0.05}  # [rad or m] to each side
SHARE = 0.8  # of the way to a limit, and of the greatest speed
PERIOD = 4.0  # [s] of the motion
FASTEST = 2.5  # more than the greatest speed of that motion per swing [1/s]
PLAY = 6.0  # swings to one side in a width
# of a width: guess of half an unmeasured gap, and its upper bound
GAP = 0.2
WIDER = 0.6
FRICTION = 0.02  # of a motor's torque, of Coulomb friction that nobody measured
FRICTION_SHARE = 0.1  # of the largest torque of the motion, above which it is no guess
COASTING = 1.0  # [s] in which that friction alone stops a motor from its greatest speed, at least
STEP = 0.001  # [s] of a sample of an arm with gears
RESOLVED = 2.0  # largest product of a Runge-Kutta step and the fastest mode
FEWEST = 4  # Runge-Kutta steps in a sample
PLACES = 21  # of the motion at which modes are looked at
LEFT_OUT = 0.005  # of the torque of a motion, of what nobody modelled


def starting_scenario(found: Survey, path: str, gears: bool = False) -> str:
    """Return a scenario as TOML text: every joint swings about the arm's posture, in a dead zone.

    Args:
        found: contents of the file.
        path: of the file, relative to the scenario's.
        gears: whether the arm has gears with a gap in place of dead zones.
    """
    pairs = zip(found.joints, found.q, strict=True)
    swing = np.array([_swing(joint, float(q)) for joint, q in pairs])
    widths = np.array([float(f"{width:.2g}") for width in swing / PLAY])
    points = (found.q, found.q + swing, found.q - swing, found.q)
    words: dict[str, Any] = {
        "zone": not gears,
        "gears": gears,
        "apart": gears and len(found.joints) > MOST_COUPLED,
        "title": _text(f"Arm of {Path(path).name}"),
        "path": _text(path),
        "joints": _texts(found.body.chain.joints),
        "tip": _text(found.tip),
        "posture": _toml_numbers(found.q),
        "start": _toml_numbers(np.r_[found.q, np.zeros(found.q.size)]),
        "right": 0.0 if gears else _toml_numbers(widths),
        "left": 0.0 if gears else _toml_numbers(widths / 2),
        "noise": _toml_numbers(widths / 50),
        "points": ", ".join(map(_toml_numbers, points)),
        "times": [0.0, PERIOD / 4, 3 * PERIOD / 4, PERIOD],
        "ranges": ", ".join(map(_range, widths)),
        "x_std": _toml_numbers(np.r_[widths / 5, widths]),
        "disturbance": _toml_numbers(LEFT_OUT * _torques(found, swing)),
        "duration": 2 * PERIOD,
    }
    template = files("undeadzone.scenario").joinpath("urdf_start.toml").read_text(encoding="utf-8")
    words |= _units(found.joints, bodies=1 + gears)
    return fill_words(template, words | (_gears(found, swing, widths) if gears else {}))


def _gears(found: Survey, swing: Floats, widths: Floats) -> dict[str, Any]:
    """Return gears that might be the arm's, with the numbers that a filter and a simulation need.

    Motors are as heavy as the links that they move. A wrist's link alone may have a thousandth of
    the inertia of any rotor behind a reduction, so the coasting time sets a lower bound.
    """
    most = FRICTION_SHARE * np.max(_torques(found, swing))  # limits of files may be anything
    chain = found.body.chain
    friction = np.fmin(FRICTION * chain.torque, most)
    inertia = np.fmax(_links(found), COASTING * friction / chain.speed)
    guessed = {"half": GAP * widths, "inertia": inertia, "friction": friction}
    written = {name: _toml_numbers(numbers) for name, numbers in guessed.items()}
    numbers_of_gears = {name: json.loads(numbers) for name, numbers in written.items()}
    arm = build_geared_arm(chain, Gears(**numbers_of_gears))
    postures = found.q + np.linspace(-1, 1, PLACES)[:, None] * swing
    steps = int(np.ceil(STEP * fastest_contact(arm, arm.values, postures) / RESOLVED))
    ranges = [f"[0.0, {float(f'{WIDER * width:.3g}')}]" for width in widths]
    range_text = ranges[0] if len({*ranges}) == 1 else f"[{', '.join(ranges)}]"
    return {**written, "half_ranges": range_text, "step": STEP, "substeps": max(steps, FEWEST)}


def _torques(found: Survey, swing: Floats) -> Floats:
    """Return the torque of each joint that holds the arm and swings it (N) [N m or N]."""
    return np.asarray(abs(found.holding) + FASTEST**2 * _links(found) * swing)


def _links(found: Survey) -> Floats:
    """Return inertia of the links as felt at each joint in the posture (N) [kg m^2 or kg]."""
    return np.diag(found.body.mass(found.body.values, found.q).full())


def _swing(joint: Joint, q: float) -> float:
    """Return the travel of a joint to each side of a position [rad or m]. Raises InputError."""
    low, high = joint.limits
    if not low < q < high:
        raise InputError(
            f"at: {joint.name} stands at its limit {q:g} and cannot swing: move it off"
        )
    return min(SWING[joint.kind], SHARE * min(q - low, high - q, joint.velocity / FASTEST))


def _units(joints: list[Joint], bodies: int) -> dict[str, str]:
    """Return the names of the units, with two bodies a joint where motors are apart from links."""
    slides = [joint.kind == "prismatic" for joint in joints]
    units = list(np.where(slides, "m", "rad")) * bodies
    speeds = [f"{unit}/s" for unit in units]
    both = len(set(slides)) == 2
    output, force = ("m", "N") if slides[0] else ("rad", "N m")
    return {
        "output": _text("rad or m" if both else output),
        "input": _text("N m or N" if both else force),
        "state": _texts([*units, *speeds]),
    }


def _text(words: str) -> str:
    """Return a text in TOML."""
    return escape_json_controls(json.dumps(words, ensure_ascii=False))


def _texts(many: Sequence[str]) -> str:
    """Return texts as a list in TOML."""
    return f"[{', '.join(map(_text, many))}]"


def _range(width: float) -> str:
    """Return a range assumed for a width."""
    return f"[0.0, {3 * width:.3g}]"


def _toml_numbers(values: Floats) -> str:
    """Return numbers as a list in TOML, to six digits."""
    return str([float(f"{value:.6g}") for value in values])
