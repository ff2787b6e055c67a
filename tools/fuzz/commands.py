"""Commands on scenarios with a few keys changed: short runs, and their exit codes."""

from __future__ import annotations

import random
from typing import Final

from tools.fuzz.case import Case
from tools.fuzz.mutate import mutated
from tools.fuzz.scenarios import NAME, text
from tools.fuzz.valid import scenario

COMMANDS: Final = (
    ("run", "--no-figures"),
    ("run", "--no-figures", "--json"),
    ("run", "--no-figures", "--out", "out"),
    ("check", "--no-figures"),
    ("check", "--no-figures", "--json"),
    ("ensemble", "--no-figures", "--runs", "5", "--out", "out"),
    ("export", "--out", "out"),
    ("design", "--no-figures", "--json"),
    ("tune", "--no-figures", "--runs", "2", "--budget", "4"),
    ("arena", "--methods", "certified,kalman", "--seeds", "1", "--processes", "1"),
)
WEIGHTS: Final = (10, 10, 5, 6, 6, 2, 3, 1, 1, 1)


def case(draw: random.Random) -> Case:
    """A command on a scenario."""
    name, *options = draw.choices(COMMANDS, WEIGHTS)[0]
    tables = scenario(draw)
    if draw.random() < 0.85:
        tables = mutated(draw, tables)
    if name == "tune" and "tune" not in tables:
        tables["tune"] = {"observer.gamma": {"between": [0.1, 10.0], "log": True}, "held_out": 2}
    if name == "ensemble" and "ensemble" not in tables:
        tables["ensemble"] = {"sensor.right": {"uniform": [0.1, 0.5]}}
    return Case(name, {NAME: text(tables)}, [name, NAME, *options])
