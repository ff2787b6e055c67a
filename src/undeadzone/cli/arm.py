"""undeadzone arm ROBOT.urdf"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import PATH, cmd, flag, force_option, option, writable
from undeadzone.cli.output import Output, common
from undeadzone.errors import InputError
from undeadzone.util.files import write_text
from undeadzone.util.shown import Block

if TYPE_CHECKING:
    from undeadzone.plants.robots.survey import Survey

OWN = ("name", "kind", "limits", "velocity", "effort")  # of a joint, as the file has them
HEAD = ("joint", "moves", "from", "to", "speed", "torque", "to hold", "b", "f", "carries")


@click.command(epilog="Example: undeadzone arm panda.urdf --tip panda_hand --out panda")
@click.argument("robot", type=PATH, metavar="ROBOT.urdf")
@option("--tip", "LINK", "Link in which the arm ends.")
@option(
    "--joints",
    "NAME,...",
    "Joints that move, from base to tip (default: all; the others are fixed at 0).",
)
@option("--at", "Q1,...", "Posture [rad or m] (default: 0, or the middle between limits).")
@flag("--gears", "Write gears with a gap in place of dead zones.")
@force_option
@common
def arm(
    robot: Path,
    tip: str | None,
    joints: str | None,
    at: str | None,
    gears: bool,
    output: Output,
    force: bool,
) -> int:
    """Show the arm in a URDF file: joints, limits, masses, tip, reach, torques that hold it.

    With --out it writes NAME.toml to DIR, a scenario to start from: every joint swings about the
    posture, with a dead zone there, or behind --gears whose numbers are a guess to be replaced.
    Exit code 1: its motors cannot hold the arm in this posture.
    """
    from undeadzone.plants.robots.survey import survey

    folder = None if output.out is None else writable(output.out)
    names = None if joints is None else [name.strip() for name in joints.split(",")]
    found = survey(robot, names, tip, None if at is None else _numbers(at))
    written = [] if folder is None else [_write_scenario(found, robot, folder, gears, force)]
    weak = _weak(found)
    next_ = _advice(found, weak, written, robot)
    blocks: list[Block] = [_in_words(found, robot), [HEAD, *_rows(found)], next_]
    output.show(lambda: _in_numbers(found), lambda: blocks, written, last={})
    return 1 if weak else 0


def _numbers(text: str) -> list[float]:
    """Return the numbers of an option. Raises InputError."""
    try:
        return [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(
            f"at: expected numbers with commas between, such as 0,-1.57,1.57, found {text!r:.60}"
        ) from None


def _write_scenario(found: Survey, robot: Path, folder: Path, gears: bool, force: bool) -> Path:
    """Return the scenario that was written. Raises FileError where there is one already."""
    from undeadzone.scenario.urdf_start import starting_scenario
    from undeadzone.util.own_files import require_own

    path = folder / f"{robot.stem}.toml"
    require_own(path, force)  # it is for the user to edit: without a mark
    relative = Path(os.path.relpath(robot, folder)).as_posix()
    return write_text(starting_scenario(found, relative, gears), path)


def _weak(found: Survey) -> list[str]:
    """Names of the joints whose motors cannot hold the arm."""
    limits = found.body.chain.torque
    pairs = zip(found.joints, abs(found.holding) > limits, strict=True)
    return [joint.name for joint, over in pairs if over]


def _in_words(found: Survey, robot: Path) -> dict[str, Any]:
    """What the file says, a line each."""
    from undeadzone.util.arrays import list_numbers

    tree = found.robot
    reach = "no limit: a sliding joint has none"
    if found.reach is not None:
        reach = f"{found.reach:.4g} m from {found.joints[0].name} to the tip at most"
    shown: dict[str, Any] = {
        "file": f"{robot}: {len(tree.links)} links, {len(tree.joints)} joints",
        "arm": f"{len(found.joints)} joints move, from {found.base} to {found.tip}",
        "posture": f"q = ({list_numbers(found.q)}) [rad or m]",
        "tip": f"({list_numbers(found.place)}) m there, seen from the base",
        "reach": reach,
    }
    if found.fixed:
        shown["fixed at 0"] = ", ".join(found.fixed)
    return shown


def _rows(found: Survey) -> list[list[str]]:
    """Return a row for each joint."""
    rows = []
    least = 1e-9 * max(abs(found.holding), default=0.0)  # what is left of 0 by rounding
    for joint, mass, torque in zip(found.joints, found.masses, found.holding, strict=True):
        holding = 0.0 if abs(torque) <= least else torque
        slides = joint.kind == "prismatic"
        unit, force = ("m", "N") if slides else ("rad", "N m")
        row = [joint.name, "slides" if slides else "turns"]
        row += [_limit(end, unit) for end in joint.limits]
        row += [_limit(joint.velocity, f"{unit}/s"), _limit(joint.effort, force)]
        row += [f"{holding:.3g} {force}", *(f"{share:.3g}" for share in joint.friction)]
        rows.append([*row, f"{mass:.4g} kg"])
    return rows


def _limit(value: float, unit: str) -> str:
    """Return a limit with its unit; a file need not have it."""
    return f"{value:.4g} {unit}" if abs(value) < float("inf") else "none"


def _advice(found: Survey, weak: list[str], written: list[Path], robot: Path) -> str:
    """What to do next."""
    if weak:
        return f"NO: the motors of {', '.join(weak)} cannot hold the arm there; try another --at"
    if written:
        return f"wrote {written[0]}; next: {cmd('undeadzone', 'run', written[0])}"
    missing = []
    if not any(any(joint.friction) for joint in found.joints):
        missing.append("friction (plant.parameters b1, f1, ...)")
    missing.append("the dead zone of each joint (sensor.right, sensor.left; --gears: their gaps)")
    return (
        f"the file does not know {' and '.join(missing)}; "
        f"a scenario to start from: {cmd('undeadzone', 'arm', robot, '--out', '.')}"
    )


def _in_numbers(found: Survey) -> dict[str, Any]:
    """What the file says, for JSON."""
    joints = []
    for joint, mass, holding in zip(found.joints, found.masses, found.holding, strict=True):
        own = {name: getattr(joint, name) for name in OWN}
        friction = dict(zip(("viscous", "coulomb"), joint.friction, strict=True))
        joints.append(own | {"holding": float(holding)} | friction | {"mass": float(mass)})
    return {
        "base": found.base,
        "tip": found.tip,
        "joints": joints,
        "fixed": found.fixed,
        "at": found.q.tolist(),
        "place": found.place.tolist(),
        "reach": found.reach,
    }
