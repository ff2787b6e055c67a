"""Command lines: every command with every option, right, wrong and missing values."""

from __future__ import annotations

import os
import random
from pathlib import Path
from typing import Any, Literal

import click

from tools.fuzz.case import Case
from tools.fuzz.damage import TEXTS, number
from tools.fuzz.scenarios import NAME, text
from undeadzone.cli import group

CONTEXT = click.Context(group)
OF_TOOL = ("run", "ensemble", "tune", "check", "design", "init", "estimate", "watch", "arm")
COMMANDS = [group.get_command(CONTEXT, name) for name in OF_TOOL]
SMALL = {
    "plant": {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]]},
    "sensor": {"right": 0.5, "left": 0.3},
    "reference": {"kind": "sine", "amplitude": 2.0, "frequency": 1.0},
    "observer": {"method": "certified"},
    "controller": {"method": "state_feedback", "alpha": 5.0},
    "simulation": {"duration": 0.5, "step": 0.01},
}
LOG = b"t,y,u\n0,0,0\n0.01,0.1,1\n0.02,0.2,1\n"
FILES = {NAME: text(SMALL), "log.csv": LOG, "empty": b"", "bad.toml": b"[plant]\nA = 1\n"}
# What runs for long if nothing is wrong with it is given something that is.
LONG = ("paper", "arena", "design", "tune", "ensemble")
# A command may write what an option names: none leads out of the folder, least of all to a device.
INSIDE = [text for text in TEXTS if "/" not in text]
WORDS = ("1", "0", "3", "kalman,certified", "observer.gamma=0.1:10:log", "y=1", "out", "x,y", "-")


def case(draw: random.Random) -> Case:
    """A command line."""
    command = draw.choice(COMMANDS)
    words: list[str] = []
    for parameter in command.params:
        words += _argument(draw, command, parameter)
    if command.name in LONG:
        words += [draw.choice(("--nonsense", "--help", "--seed=x", "--out=empty/x")), "--nonsense"]
    if draw.random() < 0.1:
        draw.shuffle(words)
    stdin = draw.choice((b"", LOG, b"\xff\xfe", b"nonsense\n"))
    apart: Literal["", "forked"] = "forked" if "--untrusted" in words else ""  # it lasts
    return Case(
        str(command.name), FILES, [str(command.name), *words], stdin, None, _pipe, ".", apart
    )


def _pipe(folder: Path) -> None:
    """A pipe, which is never read to its end."""
    os.mkfifo(folder / "pipe")


def _argument(draw: random.Random, command: Any, parameter: Any) -> list[str]:
    """The words of a parameter, if it is given."""
    if isinstance(parameter, click.Argument):
        return [] if draw.random() < 0.03 else [_path(draw, str(parameter.name))]
    if draw.random() < 0.7:
        return []
    option = draw.choice(parameter.opts)
    if parameter.is_flag:
        return [option]
    if draw.random() < 0.05:
        return [option, "--nonsense"]  # its value, or missing
    return [option, _word(draw, parameter.type)]


def _path(draw: random.Random, name: str) -> str:
    """A file that is right, or not."""
    if draw.random() < 0.6:
        return "log.csv" if name == "log" else NAME
    return draw.choice(("bad.toml", "missing", "empty", "log.csv", ".", "pipe", "", NAME))


def _word(draw: random.Random, kind: Any) -> str:
    """A value of an option."""
    act = draw.randrange(4)
    if isinstance(kind, click.Choice) and act:
        return str(draw.choice(kind.choices))
    if act == 0:
        return draw.choice(INSIDE)
    if act == 1:
        return str(number(draw))
    return draw.choice(WORDS)
