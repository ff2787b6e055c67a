"""undeadzone arm ROBOT.urdf"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from undeadzone.cli.common import (
    READ,
    flag_option,
    force_option,
    require_writable,
    shell_command,
    typed_command,
    value_option,
)
from undeadzone.cli.output import Output, add_output_options
from undeadzone.errors import InputError
from undeadzone.util.files import write_text
from undeadzone.util.shown import Block

if TYPE_CHECKING:
    from undeadzone.plants.robots.survey import Survey

OWN = ("name", "kind", "limits", "velocity", "effort")  # of a joint, as the file has them
HEAD = ("joint", "moves", "from", "to", "speed", "torque", "to hold", "b", "f", "carries")


@click.command(epilog="Example: undeadzone arm panda.urdf --tip panda_hand --out panda")
@click.argument("robot", type=READ, metavar="ROBOT.urdf")
@value_option("--tip", "LINK", "Link in which the arm ends.")
@value_option(
    "--joints",
    "NAME,...",
    "Joints that move, from base to tip (default: all, and the others are fixed at 0).",
)
@value_option("--at", "Q1,...", "Posture [rad or m] (default: 0, or the middle between limits).")
@flag_option("--gears", "Write gears with a gap in place of dead zones.")
@force_option
@add_output_options
def arm(
    robot: Path,
    tip: str | None,
    joints: str | None,
    at: str | None,
    gears: bool,
    output: Output,
    force: bool,
) -> bool:
    """Show the arm in a URDF file: joints, limits, masses, tip, reach, torques that hold it.

    With --out it writes NAME.toml to DIR, a scenario to start from: every joint swings about the
    posture, with a dead zone there, or behind --gears whose numbers are a guess to be replaced.
    Exit code 1: its motors cannot hold the arm in this posture.
    """
    from undeadzone.plants.robots.survey import survey_urdf

    folder = None if output.out is None else require_writable(output.out)
    names = None if joints is None else list(map(str.strip, joints.split(",")))
    found = survey_urdf(robot, names, tip, None if at is None else _parse_numbers(at))
    written = [] if folder is None else [_write_scenario(found, robot, folder, gears, force)]
    weak = _list_weak_joints(found)
    blocks: list[Block] = [
        _survey_to_text(found, robot),
        [HEAD, *_joint_rows(found)],
        _advise_after_survey(found, weak, written),
    ]
    output.print_result(lambda: _survey_to_json(found), lambda: blocks, written, last={})
    return not weak


def _parse_numbers(text: str) -> list[float]:
    """Return the numbers of an option. Raises InputError."""
    try:
        return list(map(float, text.split(",")))
    except ValueError:
        raise InputError(
            f"at: expected numbers with commas between, such as 0,-1.57,1.57, found {text!r:.60}"
        ) from None


def _write_scenario(found: Survey, robot: Path, folder: Path, gears: bool, force: bool) -> Path:
    """Write the scenario and return its path. Raises FileError if the file exists already."""
    from undeadzone.scenario.urdf_start import starting_scenario
    from undeadzone.util.own_files import require_own_file

    path = folder / f"{robot.stem}.toml"
    require_own_file(path, force)  # it is for the user to edit: without a mark
    relative = Path(os.path.relpath(robot, folder)).as_posix()
    return write_text(starting_scenario(found, relative, gears), path)


def _list_weak_joints(found: Survey) -> list[str]:
    """Return the names of the joints whose motors cannot hold the arm."""
    limits = found.body.chain.torque
    pairs = zip(found.joints, abs(found.holding) > limits, strict=True)
    return [joint.name for joint, over in pairs if over]


def _survey_to_text(found: Survey, robot: Path) -> dict[str, Any]:
    """Return the content of the file as text by name."""
    from undeadzone.util.arrays import list_numbers

    reach = "no limit: a sliding joint has none"
    if found.reach is not None:
        reach = f"{found.reach:.4g} m from {found.joints[0].name} to the tip at most"
    summary: dict[str, Any] = {
        "file": f"{robot}: {len(found.robot.links)} links, {len(found.robot.joints)} joints",
        "arm": f"{len(found.joints)} joints move, from {found.base} to {found.tip}",
        "posture": f"q = ({list_numbers(found.q)}) [rad or m]",
        "tip": f"({list_numbers(found.place)}) m there, seen from the base",
        "reach": reach,
    }
    if found.fixed:
        summary["fixed at 0"] = (
            ", ".join(found.fixed) + ". Each link behind moves with the one that carries it"
        )
    return summary


def _joint_rows(found: Survey) -> list[list[str]]:
    """Return a row for each joint."""
    rows = []
    least = 1e-9 * max(abs(found.holding), default=0.0)  # a zero after rounding
    for joint, mass, torque in zip(found.joints, found.masses, found.holding, strict=True):
        holding = 0.0 if abs(torque) <= least else torque
        slides = joint.kind == "prismatic"
        unit, force = ("m", "N") if slides else ("rad", "N m")
        row = [joint.name, "slides" if slides else "turns"]
        row += [_format_limit(end, unit) for end in joint.limits]
        row += [_format_limit(joint.velocity, f"{unit}/s"), _format_limit(joint.effort, force)]
        row += [f"{holding:.3g} {force}", *(f"{share:.3g}" for share in joint.friction)]
        rows.append([*row, f"{mass:.4g} kg"])
    return rows


def _format_limit(value: float, unit: str) -> str:
    """Return a limit with its unit as text, "none" if it is infinite."""
    return f"{value:.4g} {unit}" if abs(value) < float("inf") else "none"


def _advise_after_survey(found: Survey, weak: list[str], written: list[Path]) -> str:
    """Return the advice on the next step."""
    if weak:
        return f"NO: the motors of {', '.join(weak)} cannot hold the arm there. Try another --at"
    if written:
        return f"wrote {written[0]}; next: {shell_command('undeadzone', 'run', written[0])}"
    missing = ["the dead zone of each joint (sensor.right, sensor.left; --gears: their gaps)"]
    if not any(any(joint.friction) for joint in found.joints):
        missing.insert(0, "friction (plant.parameters b1, f1, ...)")
    return (
        f"the file does not know {' and '.join(missing)}. "
        f"A scenario to start from: {typed_command('--out', '.')}"
    )


def _survey_to_json(found: Survey) -> dict[str, Any]:
    """Return the content of the file for JSON."""
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
