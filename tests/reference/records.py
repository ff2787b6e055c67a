"""Family of records of plants: `../shared/records`, where it is there. No record is copied."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.identify import labelled_records

from .benches import judged, noted_answers, with_false_odds, word_of
from .fields import Answer

FOLDER = Path(__file__).parents[3] / "shared" / "records"
LOOPS = 16  # of all loops, drawn: each takes 5 s
SEED = 76


class Truth(NamedTuple):
    """Truth of a record, and how it is asked.

    Attributes:
        right: verdicts that are right; None: nobody knows.
        options: of `identify`.
        sizes: numbers that are known, by their keys.
    """

    right: tuple[str, ...] | None = None
    options: dict[str, Any] = {}
    sizes: dict[str, float] = {}


OURS = {"columns": "u=u,y=y"}  # z_true is a column, too
ZONE = {"right": 0.6, "left": 0.3}
TRUTHS = {  # as the records' README says
    "log_after": Truth(("dead_zone",), OURS, ZONE),
    "log_coloured": Truth(("dead_zone",), OURS, ZONE),
    "log_cubic_oscillator": Truth(("dead_zone",), OURS, {"right": 0.46829, "left": 0.234145}),
    "log_jump": Truth(("jump",), OURS, ZONE),
    "log_none": Truth(("none",), OURS),
    "log_play": Truth(("play",), OURS, {"width": 0.8}),
    "log_saturation": Truth(("saturation",), OURS),
    "log_white": Truth(("dead_zone",), OURS, ZONE),
    "daisy_robot_arm": Truth(("none", "operating_point"), {"columns": "u=torque,y=acceleration"}),
    "motors/dc_motor_driver": Truth(("input_zone",)),
    "motors/drive_torque": Truth(("friction",), {"columns": "u=data[4],y=data[3],t=data[0]"}),
    "motors/friction_damper": Truth(),
    "motors/guiding_declination": Truth(("play",), {"columns": "u=decpulse,y=dec"}),
    "motors/guiding_log_head": Truth(),
    "motors/lab_motor_sine": Truth(("input_zone", "friction")),  # a zone of the sensor is wrong
    "motors/leg_thigh": Truth(),  # friction; a goal and a position
    "motors/servo_monitor_head": Truth(),
}


def find_paths() -> dict[str, Path]:
    """Return all records by name, with as many loops as `LOOPS`, the same each time."""
    every = {
        path.relative_to(FOLDER).with_suffix("").as_posix(): path
        for path in sorted(FOLDER.rglob("*"))
        if path.suffix in (".csv", ".mat", ".txt")
    }
    loops = [name for name in every if name.startswith("loops/")]
    drawn = random.Random(SEED).sample(loops, min(LOOPS, len(loops)))
    return {name: path for name, path in every.items() if name not in loops or name in drawn}


def truth_of(name: str) -> Truth:
    """Return the truth of a record; that of a loop is the label in its name.

    Args:
        name: of the record.
    """
    if not name.startswith("loops/"):
        return TRUTHS.get(name, Truth())
    label = name.removeprefix("loops/").removeprefix("isdb_")
    return Truth(labelled_records.STICKS if label.startswith("S_") else labelled_records.MOVES)


def ask_record(name: str) -> Answer:
    """Return the answer to a record.

    Args:
        name: of the record, as `find_paths` has it.
    """
    path, truth = find_paths()[name], truth_of(name)
    with noted_answers() as noted:
        one = labelled_records.ask(path.stem, truth.right or (), None, log=path, **truth.options)
    answer = judged(noted, word_of(one.is_right, one.is_wrong), truth.right or (), None, {})
    if truth.right is None:
        fields = {key: value for key, value in answer.fields.items() if key != "word"}
        return Answer(fields, {})
    return with_false_odds(answer._replace(truth=answer.truth | truth.sizes), one)


def find_obstacle() -> str:
    """Return why no record can be asked; "" if they are there."""
    return "" if FOLDER.is_dir() else "the records are not there (../shared/records)"
