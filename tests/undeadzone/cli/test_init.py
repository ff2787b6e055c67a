"""The file that `undeadzone init` writes: every alternative in it runs when it is taken."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import undeadzone as uz
from undeadzone.scenario.reader import parse
from undeadzone_studies.ensemble.binding import require_bound

TEMPLATE = files("undeadzone").joinpath("template.toml").read_text(encoding="utf-8")
KEY = r"(?:[A-Za-z]\w*|\"[^\"]+\") = "
# Keys of a table that stand against an alternative of it, where these are not all of them.
AGAINST = {"plant": ("A", "B", "C")}
# Options that are added to their table, the others staying.
ADDED = ("sensor", "model", "ensemble", "units")


class Alternative(NamedTuple):
    """Lines that may be taken in place of others.

    Attributes:
        table: where they stand.
        lines: as they are when taken.
    """

    table: str
    lines: list[str]


def tables() -> dict[str, list[str]]:
    """The lines of each table, the header aside, also of those behind #."""
    found: dict[str, list[str]] = {"": []}
    name = ""
    for line in TEMPLATE.split("\n"):
        header = re.match(r"(?:# )?\[(\w+)\]", line)
        if header is None:
            found[name].append(line)
        else:
            name = header[1]
            found[name] = []
    return found


def alternatives() -> Iterator[Alternative]:
    """What stands behind #: lines under one remark belong together, as do those of a `kind`."""
    for name, lines in tables().items():
        group: list[str] = []
        for line in lines:
            if not re.match(rf"# {KEY}", line):
                yield from whole(name, group)
                group = []
            else:
                group.append(line.removeprefix("# "))
        yield from whole(name, group)


def whole(table: str, group: list[str]) -> Iterator[Alternative]:
    """One alternative of several lines, or several of one line each."""
    if not group:
        return
    single = table == "plant" and not group[0].startswith("states")
    if table in ("sensor", "controller") or single:
        for line in group:
            yield Alternative(table, [line])
    else:
        yield Alternative(table, group)


def scenario_text(choice: Alternative) -> str:
    """The template with an alternative in place of what it stands against, and nothing else."""
    text = []
    for name, lines in tables().items():
        selected = [line for line in lines if re.match(KEY, line)]
        if name == choice.table and name not in (*ADDED, "controller"):
            against = AGAINST.get(name, tuple(line.split(" = ")[0] for line in selected))
            selected = [line for line in selected if line.split(" = ")[0] not in against]
        if name == choice.table:
            selected += choice.lines
        if selected:
            text += [f"[{name}]"] * bool(name) + selected
    return "\n".join(text)


CHOICES = list(alternatives())


def test_the_template_offers_what_it_should() -> None:
    offered = [line for choice in CHOICES for line in choice.lines]
    assert len(offered) == len(re.findall(rf"^# {KEY}", TEMPLATE, re.M))
    assert {choice.table for choice in CHOICES} > {"plant", "reference", "observer", "ensemble"}
    assert len(CHOICES) > 15


@pytest.mark.parametrize("choice", CHOICES, ids=lambda choice: f"{choice.table}-{choice.lines[0]}")
def test_every_alternative_runs_when_it_is_selected(choice: Alternative, tmp_path: Path) -> None:
    (tmp_path / "reference.csv").write_text("0.0,0.0\n1.0,2.0\n30.0,-2.0\n")
    scenario = parse(scenario_text(choice), tmp_path)
    if scenario.ensemble is not None:
        require_bound(scenario)
    run = uz.simulate(scenario | {"simulation": {"duration": 0.5}, "ensemble": None})
    assert run.divergence_time is None
    assert np.isfinite(run.rms_estimation)
