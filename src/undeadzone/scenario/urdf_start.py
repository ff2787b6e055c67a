"""A scenario to start from for an arm of a URDF file, ready to run and to change."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from undeadzone.errors import InputError
from undeadzone.observers.contact import MOST_COUPLED
from undeadzone.plants.robots.survey import Survey
from undeadzone.plants.robots.urdf_elements import Joint
from undeadzone.support.arrays import Floats
from undeadzone.support.text import json_line

SWING = {"revolute": 0.3, "continuous": 0.3, "prismatic": 0.05}  # [rad or m] to each side
SHARE = 0.8  # of the way to a limit, and of the greatest speed
PERIOD = 4.0  # [s] of the motion
FASTEST = 2.5  # more than the greatest speed of that motion per swing [1/s]
PLAY = 6.0  # swings to one side in a width
GAP, WIDER = 0.2, 0.6  # of a width: half a gap that nobody measured, and where it surely ends
FRICTION = 0.02  # of a motor's torque, of Coulomb friction that nobody measured
LEFT_OUT = 0.005  # of the torque of a motion, of what nobody modelled
SENSOR = """
[sensor]                        # about the reference: the truth; the observer is not told
right = {right}
left = {left}
noise = {noise}
"""
REFERENCE = """
[reference]                     # through these positions, again and again
kind = "quintic"
points = [{points}]
times = {times}   # s
repeat = true
"""
GEARS = """
[plant.arm.gears]               # a guess: a URDF knows none of them (docs/robots.md)
half = {half}  # rad or m, half of the gap: hold the motor, turn the link, halve the way
inertia = {inertia}  # kg m^2 or kg, rotor times gear ratio squared; here as the links'
friction = {friction}  # N m or N, Coulomb friction of the motors; here 2 % of their torque
measured = "motor"              # where the encoder sits: "motor", "link" or "both"
"""
ENCODERS = """
[sensor]                        # encoders: no dead zone
right = 0.0
left = 0.0
noise = {noise}
"""
CONTACT = """
[observer]
method = "contact"
half = [0.0, {most:.3g}]           # rad, claimed range
payload = [0.0, 1.0]            # kg, claimed range
"""
TOLD = """
[observer]                      # or "contact" with joints = "separate" (docs/methods/contact.md)
method = "full_state"           # told the state: what the gears allow
"""
LED = """
[controller]
method = "computed_torque"
bandwidth = 10.0                # rad/s

[simulation]
time = "sampled"
duration = {duration}
step = 0.001
substeps = 4
"""
PARAMETERS = """
[plant.parameters]              # the truth; the file's numbers where they are left out
payload = 0.0                   # kg at the tip
# b1 = 0.5                      # N m s/rad, viscous friction of the first joint
# f1 = 2.0                      # N m, Coulomb friction

# [model.parameters]            # what observer and controller believe instead
# payload = 0.0
"""
OBSERVER = """
[observer]
method = "extended"             # the whole arm at once; joints = "separate" is cheaper
right = [{ranges}]  # claimed ranges of both widths
start = {start}
x_std = {x_std}
disturbance = {disturbance}  # rms of what the model leaves out; here 0.5 % of all

[controller]
method = "computed_torque"
bandwidth = 10.0                # rad/s

[compare]                       # the same filter, to which every reading is the truth
like = "observer"
blind = true

[simulation]
time = "sampled"
duration = {duration}
step = 0.002
substeps = 1
"""


def starting_scenario(found: Survey, path: str, gears: bool = False) -> str:
    """A scenario as TOML text: every joint swings about the arm's posture, in a dead zone.

    Args:
        found: what the file says.
        path: of the file, relative to the scenario's.
        gears: whether the arm has gears with a gap in place of dead zones.
    """
    pairs = zip(found.joints, found.q, strict=True)
    swing = np.array([_swing(joint, float(q)) for joint, q in pairs])
    widths = np.array([float(f"{width:.2g}") for width in swing / PLAY])
    start = _listed(np.r_[found.q, np.zeros(found.q.size)])
    points = (found.q, found.q + swing, found.q - swing, found.q)
    times = [0.0, PERIOD / 4, 3 * PERIOD / 4, PERIOD]
    reference = REFERENCE.format(points=", ".join(map(_listed, points)), times=times)
    if gears:
        few = len(found.joints) <= MOST_COUPLED
        head = _arm(found, path, start, gears) + _gears(found, widths) + PARAMETERS
        observer = CONTACT.format(most=WIDER * widths.max()) if few else TOLD
        encoders = ENCODERS.format(noise=_listed(widths / 50))
        led = LED.format(duration=2 * PERIOD)
        return head + encoders + reference + observer + led + _units(found.joints, bodies=2)
    sensor = SENSOR.format(
        right=_listed(widths), left=_listed(widths / 2), noise=_listed(widths / 50)
    )
    observer = OBSERVER.format(
        ranges=", ".join(map(_range, widths)),
        start=start,
        x_std=_listed(np.r_[widths / 5, widths]),
        disturbance=_listed(LEFT_OUT * (abs(found.holding) + FASTEST**2 * _links(found) * swing)),
        duration=2 * PERIOD,
    )
    head = _arm(found, path, start) + PARAMETERS + sensor + reference
    return head + observer + _units(found.joints)


def _arm(found: Survey, path: str, start: str, gears: bool = False) -> str:
    """The arm, and where it starts, without a zone where it has gears."""
    zone = [] if gears else [f"reference = {_listed(found.q)}  # where each sensor reads 0"]
    lines = [
        f"title = {_text(f'Arm of {Path(path).name}')}",
        "",
        "[plant.arm]",
        'kind = "urdf"',
        f"path = {_text(path)}",
        f"joints = {_texts(found.body.chain.joints)}",
        f"tip = {_text(found.tip)}",
        *zone,
        "",
        "[plant]",
        f"x0 = {start}  # positions, then speeds",
    ]
    return "\n".join(lines) + "\n"


def _gears(found: Survey, widths: Floats) -> str:
    """Gears that might be the arm's: motors as heavy as what they move."""
    torque = found.body.chain.torque
    friction = FRICTION * np.where(np.isfinite(torque), torque, np.abs(found.holding))
    guessed = {"half": GAP * widths, "inertia": _links(found), "friction": friction}
    return GEARS.format(**{name: _listed(numbers) for name, numbers in guessed.items()})


def _links(found: Survey) -> Floats:
    """Inertia of the links as felt at each joint in the posture (N) [kg m^2 or kg]."""
    return np.diag(found.body.mass(found.body.values, found.q).full())


def _swing(joint: Joint, q: float) -> float:
    """How far a joint swings to each side of a position [rad or m]. Raises InputError."""
    low, high = joint.limits
    if not low < q < high:
        raise InputError(
            f"at: {joint.name} stands at its limit {q:g} and cannot swing: move it off"
        )
    return min(SWING[joint.kind], SHARE * min(q - low, high - q, joint.velocity / FASTEST))


def _units(joints: list[Joint], bodies: int = 1) -> str:
    """The names of the units, with two bodies a joint where motors are apart from links."""
    slides = [joint.kind == "prismatic" for joint in joints]
    units = list(np.where(slides, "m", "rad")) * bodies
    speeds = [f"{unit}/s" for unit in units]
    both = len(set(slides)) == 2
    output, force = ("m", "N") if slides[0] else ("rad", "N m")
    lines = [
        "",
        "[units]",
        f"output = {_text('rad or m' if both else output)}",
        f"input = {_text('N m or N' if both else force)}",
        f"state = {_texts([*units, *speeds])}",
    ]
    return "\n".join(lines) + "\n"


def _text(words: str) -> str:
    """A text in TOML."""
    return json_line(json.dumps(words, ensure_ascii=False))


def _texts(many: Sequence[str]) -> str:
    """Texts as a list in TOML."""
    return f"[{', '.join(map(_text, many))}]"


def _range(width: float) -> str:
    """A range that is claimed of a width."""
    return f"[0.0, {3 * width:.3g}]"


def _listed(values: Floats) -> str:
    """Numbers as a list in TOML, to six digits."""
    return str([float(f"{value:.6g}") for value in values])
