"""Scenarios: read, and everything checked that is checked before a run."""

from __future__ import annotations

import functools
import random
from pathlib import Path

import tomli_w

from tools.fuzz.case import Case
from tools.fuzz.damage import bent
from tools.fuzz.mutate import mutated
from tools.fuzz.valid import Table, scenario
from undeadzone.scenario.problem import resolve_scenario
from undeadzone.scenario.reader import read

NAME = "mine.toml"


def case(draw: random.Random) -> Case:
    """A scenario with a few keys changed, or its text damaged."""
    kind = "keys"
    tables = scenario(draw)
    content = text(mutated(draw, tables))
    if draw.random() < 0.15:
        kind, content = "text", bent(draw, text(tables))
    return Case(kind, {NAME: content}, call=functools.partial(_checked))


def text(tables: Table) -> bytes:
    """Tables as TOML."""
    return tomli_w.dumps(tables).encode("utf-8", "replace")


def _checked(folder: Path) -> None:
    """A scenario read and resolved."""
    resolve_scenario(read(folder / NAME))
