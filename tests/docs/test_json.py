"""docs/json.md is what the commands print: each key is documented, each documented key met."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import once
import undeadzone_paper
from documents import ROOT
from undeadzone.cli import group
from undeadzone.cli.common import SCHEMA
from undeadzone.nonlinearities.play import levels
from undeadzone_export import exporting

PAGE = "".join((ROOT / f"docs/{name}.md").read_text() for name in ("json", "json_logs"))
SECTIONS = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S))
SHORT = "duration = 1.0"
COMMON = ("--json", "--no-figures")
LOG = "examples/samples.csv"
STUDY = ("--out", "study", *COMMON)
COMMANDS: dict[str, list[list[str]]] = {
    "init": [["init", "new.toml", "--json"], ["init", "--list", "--json"]],
    "arm": [["arm", "examples/ur5.urdf", "--out", "arm", "--json"]],
    "run": [
        ["run", "examples/asymmetric_noise.toml", *COMMON],
        ["run", "arm.toml", *COMMON],
        ["run", "examples/valve_both_ends.toml", *COMMON],
        ["run", "examples/geared_motor.toml", *COMMON],
        ["run", "examples/gears_and_zone.toml", *COMMON],
        ["run", "study/runs.npz", "--replay", "1", *COMMON],
    ],
    "check": [
        ["check", "examples/paper_poles.toml", *COMMON],
        ["check", "examples/paper_5sin.toml", *COMMON],
        ["check", "examples/geared_motor.toml", *COMMON],
    ],
    "design": [["design", "examples/paper_5sin.toml", "--maximise", "rate", *COMMON]],
    "ensemble": [
        ["ensemble", "examples/ensemble.toml", "--runs", "256", "--resume", *STUDY],
    ],
    "fit": [["fit", "point.toml", LOG, "--free", "sensor.right", *COMMON]],
    "tune": [["tune", "examples/tune.toml", "--runs", "2", "--budget", "4", *COMMON]],
    "arena": [
        ["arena", "examples/load_cell_limited.toml", "--methods", "kalman", "--seeds", "1",
         "--json"],
    ],
    "identify": [
        ["identify", LOG, "--order", "3", "--delay", "0", "--chain", "chain", *COMMON],
        ["identify", "axis.csv", *COMMON],
    ],
    "loops": [["loops", str(ROOT / "docs/trades/valve.csv"), *COMMON]],
    "estimate": [
        ["estimate", "examples/asymmetric_noise.toml", LOG, *COMMON],
        ["estimate", "examples/load_cell_limited.toml", LOG, "--columns", "t=t,y=y,u=u", *COMMON],
        ["estimate", "valve.toml", LOG, *COMMON],
        ["estimate", "point.toml", LOG, *COMMON],
        ["estimate", "gears.toml", LOG, *COMMON],
        ["estimate", "arm.toml", "arm/run.csv", *COMMON],
    ],
    "export": [
        ["export", "examples/firmware.toml", "--out", "c", "--check", "--json"],
        ["export", "examples/firmware.toml", "--to", "st", "--out", "st", "--json"],
    ],
    "paper": [["paper", *COMMON]],
}  # fmt: skip
PREPARED = {
    "arm.toml": ("two_link.toml", {"duration = 20.0": SHORT}),
    "valve.toml": ("valve_both_ends.toml", {"step = 0.02": "step = 0.01"}),
    "point.toml": (
        "asymmetric_noise.toml",
        {"[sensor]": "[operating_point]\noutput = 0.1\n[sensor]"},
    ),
    "gears.toml": ("gears_and_zone.toml", {"step = 0.005": "step = 0.01"}),
}
BEFORE = {
    "run": COMMANDS["ensemble"][0],
    "estimate": ["run", "arm.toml", "--out", "arm", *COMMON],
}  # what a command needs


def keys(section: str) -> list[str]:
    """The documented keys of a section."""
    rows = re.findall(r"^\| (`.*?) \|", SECTIONS[section], re.M)
    found: list[str] = []
    for row in rows:
        found += re.findall(r"`([^`]+)`", row)
    return found


def pattern(key: str) -> str:
    """A key of the page as a regular expression: {a,b} is either, a word in capitals any name."""
    parts = []
    for part in re.split(r"(\{[^}]*\}|[A-Z]{2,}|\.)", key):
        if part.startswith("{"):
            parts.append(f"(?:{'|'.join(map(re.escape, part[1:-1].split(',')))})")
        elif re.fullmatch("[A-Z]{2,}", part):
            parts.append(".+")
        else:
            parts.append(re.escape(part))
    return "".join(parts)


def paths(value: Any, path: str = "") -> Iterator[str]:
    """Where the values of an object stand; the entries of a list stand where it does."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from paths(inner, f"{path}.{key}" if path else key)
    elif isinstance(value, list) and value:
        for inner in value:
            yield from paths(inner, path)
    else:
        yield path


def is_documented(path: str, documented: list[str]) -> bool:
    """Whether a path is on the page, or would lead there if it did not end with null."""
    for key in documented:
        parts = re.split(r"\.(?![^{]*\})", key)
        starts = [".".join(parts[:length]) for length in range(1, len(parts) + 1)]
        if any(re.fullmatch(pattern(start), path) for start in starts):
            return True
    return False


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the examples."""
    folder_path = tmp_path_factory.mktemp("json")
    (folder_path / "examples").symlink_to(ROOT / "examples")
    for name, (source, changes) in PREPARED.items():
        text = (ROOT / "examples" / source).read_text()
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        (folder_path / name).write_text(text)
    goal = np.random.default_rng(0).uniform(-20.0, 20.0, 120)  # of an axis with a gap of 0.2
    at = levels(goal[:, None], np.array([0.1]), np.array([0.1]), goal[:1])[:, 0]
    rows = [f"{5 * k},{u:.3f},{y:.3f}" for k, (u, y) in enumerate(zip(goal, at, strict=True))]
    (folder_path / "axis.csv").write_text("\n".join(["t [s],goal [mm],position [mm]", *rows, ""]))
    return folder_path


def run_json(command: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """What a command prints."""
    group.main(command, standalone_mode=False)
    return dict(json.loads(capsys.readouterr().out))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_page_lists_the_keys_of_a_command(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(exporting, "STEPS", 2000)
    once.in_haste(monkeypatch)
    monkeypatch.setattr(undeadzone_paper, "audit", lambda progress: once.audit()[0])
    if name in BEFORE:
        run_json(BEFORE[name], capsys)
    documented, met = keys(name), set[str]()
    for command in COMMANDS[name]:
        printed = run_json(command, capsys)
        assert next(iter(printed)) == "schema"
        assert printed.pop("schema") == SCHEMA
        met |= set(paths(printed))
    assert sorted(path for path in met if not is_documented(path, documented)) == []
    top = {pattern(key.split(".")[0]) for key in documented}
    seen = {path.partition(".")[0] for path in met}
    assert sorted(key for key in top if not any(map(re.compile(key).fullmatch, seen))) == []


def test_every_command_has_its_section() -> None:
    names = group.list_commands(click.Context(group))
    assert {"run", "arena", "paper"} <= set(names)
    assert sorted(SECTIONS) == sorted(names)


def test_watch_lists_the_keys_of_a_line() -> None:
    from undeadzone.interfaces import COLUMNS

    documented = keys("watch")
    names = ["t", *COLUMNS, "side"]
    assert [name for name in names if not is_documented(name, documented)] == []
