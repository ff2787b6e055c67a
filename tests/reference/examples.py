"""Families of commands: the `--json` of each command on each example."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import tomllib
from pathlib import Path
from typing import Any

from tests.commands import Done, forked, undeadzone

import undeadzone as uz
from undeadzone.cli.ending import INTERNAL

from .fields import Answer, Fields, flatten

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCENARIOS = {path.stem: path for path in sorted(EXAMPLES.glob("*.toml"))}
SCENARIOS["template"] = Path(str(uz.__file__)).with_name("template.toml")  # what `init` writes
LOG, OF_LOG = EXAMPLES / "samples.csv", EXAMPLES / "asymmetric_noise.toml"  # which made it

# Scenarios whose commands take more than 30 s of CPU by their own duration, and one [s] that is
# enough for every part of them to act.
BRIEF = {"two_link_gears": 1.0, "ur5": 1.0}
# What takes minutes of CPU whatever the duration: the code is large, and run 100,000 samples long.
LEFT_OUT = {"export": ("two_link_gears", "ur5")}
OPTIONS = {
    "run": ("--no-figures",),
    "check": ("--no-figures",),
    "design": ("--no-figures",),
    "export": ("--check", "--out", "code"),
}
# Commands of their own, by the name of the case. EXAMPLE.toml is a file of the folder.
COMMANDS: dict[str, tuple[str, ...]] = {
    "ensemble": ("ensemble", "ensemble.toml", "--runs", "32"),
    "ensemble two_link": ("ensemble", "two_link.toml", "--runs", "4"),
    "ensemble tune": ("ensemble", "tune.toml", "--runs", "32"),
    "tune": ("tune", "tune.toml", "--runs", "4", "--budget", "8", "--seed", "1"),
    "identify": ("identify", "samples.csv"),
    "identify order 3": ("identify", "samples.csv", "--order", "3", "--delay", "0"),
    "estimate": ("estimate", "asymmetric_noise.toml", "samples.csv"),
    "watch": ("watch", "asymmetric_noise.toml"),
    "arm": ("arm", "ur5.urdf", "--gears"),
    "paper": ("paper",),
    "arena": ("arena", "asymmetric_noise.toml", "--methods", "certified,censored,ekf",
              "--seeds", "1", "--processes", "1"),
}  # fmt: skip


def list_examples(command: str) -> list[str]:
    """Return the examples that a command is given.

    Args:
        command: of `OPTIONS`.
    """
    return [name for name in SCENARIOS if name not in LEFT_OUT.get(command, ())]


def ask(command: str, name: str) -> Answer:
    """Return the answer of a command to an example.

    Args:
        command: of `OPTIONS`.
        name: of the example, without its ending.
    """
    path = SCENARIOS[name]
    fields = run_command(command, f"{name}.toml", *OPTIONS[command], duration=BRIEF.get(name))
    truth = {}
    if command == "run" and "exit" in fields:
        truth = _truth_of_run(tomllib.loads(path.read_text(encoding="utf-8")), fields)
    return Answer(fields, truth)


def _truth_of_run(scenario: dict[str, Any], fields: Fields) -> Fields:
    """Return the sensor's widths, and 0 for errors."""
    sensor = scenario.get("sensor", {})
    truth: Fields = dict.fromkeys(("rms_tracking", "rms_estimation"), 0.0)
    truth |= {f"d_{side}": sensor.get(side) for side in ("right", "left")}
    known = {key: value for key, value in truth.items() if isinstance(value, int | float)}
    return {key: value for key, value in known.items() if fields.get(key) is not None}


def ask_of_its_own(name: str) -> Answer:
    """Return the answer of a command of `COMMANDS`.

    Args:
        name: of the case.
    """
    fields = run_command(*COMMANDS[name])
    truth: Fields = {}
    if name.startswith("identify"):
        sensor = tomllib.loads(OF_LOG.read_text(encoding="utf-8"))["sensor"]
        truth = {"verdict": ["dead_zone"], "right": sensor["right"], "left": sensor["left"]}
        fields["word"] = "right" if fields.get("verdict") in truth["verdict"] else "wrong"
    return Answer(fields, truth)


def run_command(*words: str, duration: float | None = None) -> Fields:
    """Return exit code and `--json` of a command in a new folder with the examples.

    Args:
        words: of the command.
        duration: of every scenario [s]; None: its own.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in (*EXAMPLES.iterdir(), *SCENARIOS.values()):
            if path.is_file():
                shutil.copy(path, folder)
        if duration is not None:
            for path in folder.glob("*.toml"):
                text = path.read_text(encoding="utf-8")
                changed = re.sub(r"(?m)^duration = [\d.]+", f"duration = {duration}", text)
                path.write_text(changed, encoding="utf-8")
        if words[0] == "watch":  # in a process of its own, as it owns its streams
            piped = forked(*words, "--json", cwd=folder, stdin=LOG.read_bytes())
            texts = piped.stdout.decode(), piped.stderr.decode()
            done = Done(piped.returncode, *texts)
        else:
            done = undeadzone(*words, "--json", cwd=folder)
    if done.returncode == INTERNAL:
        return {"error": done.stderr.strip().splitlines()[-1]}
    return {"exit": done.returncode} | _fields_of(done.stdout)


def _fields_of(text: str) -> Fields:
    """Return the fields of one JSON object, or count and extremes of those of many lines."""
    try:
        return flatten(json.loads(text)) if text.strip() else {}
    except json.JSONDecodeError:
        return flatten([json.loads(line) for line in text.splitlines()], "lines")


def find_obstacle() -> str:
    """Return why no self-test can be built; "" if it can."""
    return "" if shutil.which("gcc") else "there is no gcc"
