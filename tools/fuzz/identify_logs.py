"""Logs for `identify`: a motor behind its zone, and what recorders and people do to its columns."""

from __future__ import annotations

import datetime
import math
import random
from pathlib import Path
from typing import Final

from tools.fuzz.case import Case, End
from tools.fuzz.damage import NUMBERS, TEXTS, bent
from tools.fuzz.streams import written
from undeadzone.errors import UndeadzoneError
from undeadzone.scenario.reader import read

STEP: Final = 0.02
NAMES: Final = (
    "log.csv",
    "log.csv",
    "log.csv",
    "a b.csv",
    "-log.csv",
    "mötor.csv",
    "log",
    "$x.csv",
)
HEAD: Final = "t,y,u"
HEADS: Final = ("time [s];y [deg];u [V]", "y,t,u", "t,u,y", "t,t,t", "", "a,b,c")
OPTIONS: Final = (
    ("--columns", "t=1,y=2,u=3"),
    ("--columns", "y=2,u=3"),
    ("--right", "0.3"),
    ("--right", "0.1,0.6"),
    ("--right", "inf", "--left", "0.3"),
    ("--offset", "free"),
    ("--strict",),
    ("--noise", "before"),
    ("--place", "sensor"),
    ("--kind", "play"),
    ("--kind", "jump"),
    ("--delay", "1"),
    ("--integrators", "1"),
    ("--threshold", "0.01"),
    ("--resample", "0.04"),
    ("--held-out", "0.9"),
    ("--zero", "0.5"),
)
LARGEST: Final = 240  # lines, most of the time: a fit takes seconds


def case(draw: random.Random) -> Case:
    """A log and a few options; the plant is asked for with one pole."""
    rows = sound(draw, draw.choice((*range(3), 10, 40, *[LARGEST] * 8)))
    kind = draw.choice(("sound", "cells", "columns", "rows", "times"))
    {"cells": _cells, "columns": _columns, "rows": _lines, "times": _times}.get(kind, _none)(
        draw, rows
    )
    data = written(draw, rows, HEAD if draw.random() < 0.8 else draw.choice(HEADS))
    if kind == "times" and draw.random() < 0.4:
        kind, data = "dates", _dated(draw, rows)
    if draw.random() < 0.25:
        kind, data = "bytes", bent(draw, data)
    name = draw.choice(NAMES)
    words = ["identify", f"./{name}", "--order", "1", "--no-figures", "--out", "out"]
    for option in draw.sample(OPTIONS, draw.choice((0, 0, 1, 2))):
        words += option
    if draw.random() < 0.3:
        words.append("--json")
    return Case(kind, {name: data}, words, judged=_left)


def _left(folder: Path, end: End) -> str:
    """What is wrong with the files: a scenario that is none, or something of a refusal."""
    files = list((folder / "out").rglob("*"))
    if any(path.suffix == ".partial" or path.name.startswith(".") for path in files):
        return f"half-written: {', '.join(path.name for path in files)}"
    if end.code == 2 and files:
        return f"written, and refused: {', '.join(path.name for path in files)}"
    for path in files:
        if path.suffix == ".toml":
            try:
                read(path)
            except UndeadzoneError as error:
                return f"its scenario: {error}"
    return ""


def sound(draw: random.Random, count: int) -> list[list[float]]:
    """Times, readings and inputs of a plant with one pole behind a dead zone."""
    noise, zone, z, rows = draw.choice((0.0, 0.01)), draw.choice((0.0, 0.3)), 0.0, []
    for k in range(count):
        u = 2 * math.sin(3 * STEP * k) + math.sin(11 * STEP * k)
        y = max(z - zone, 0.0) + min(z + zone, 0.0)
        rows.append([k * STEP, y + noise * draw.gauss(0, 1), u])
        z += STEP * 3 * (u - z)
    return rows


def _none(draw: random.Random, rows: list[list[float]]) -> None:
    """Nothing."""


def _cells(draw: random.Random, rows: list[list[float]]) -> None:
    """Numbers that are none, or huge."""
    for _ in range(draw.choice((1, 1, 3, 30)) if rows else 0):
        draw.choice(rows)[draw.choice((0, 1, 1, 1, 2))] = draw.choice(NUMBERS)


def _columns(draw: random.Random, rows: list[list[float]]) -> None:
    """A column that is constant, exchanged, scaled or gone."""
    column, act, value = draw.randrange(3), draw.randrange(5), draw.choice(NUMBERS)
    for row in rows:
        if act == 0:
            row[column] = value
        elif act == 1:
            row[column], row[column - 1] = row[column - 1], row[column]
        elif act == 2:
            row[column] *= value
        elif act == 3:
            row[column] += value
        else:
            del row[column]


def _lines(draw: random.Random, rows: list[list[float]]) -> None:
    """Lines that are lost, twice or exchanged."""
    for _ in range(draw.choice((1, 3, 10)) if rows else 0):
        place = draw.randrange(len(rows) + 1)
        act = draw.randrange(3)
        if act == 0:
            del rows[place : place + draw.choice((1, 1, 20))]
        elif act == 1:
            rows[place:place] = [list(row) for row in rows[place : place + draw.choice((1, 5))]]
        else:
            rows[place : place + 10] = rows[place : place + 10][::-1]


def _times(draw: random.Random, rows: list[list[float]]) -> None:
    """A clock that jumps, runs wild, stands still, or counts something else."""
    act, by = draw.randrange(4), draw.choice((1e-3, 1.0, 3600.0, -1.0, 1e9, 1e-9))
    for k, row in enumerate(rows):
        if act == 0:
            row[0] = row[0] + by if k > len(rows) // 2 else row[0]
        elif act == 1:
            row[0] += draw.uniform(-1, 1) * STEP * draw.choice((0.01, 0.4, 2.0))
        elif act == 2:
            row[0] *= by
        else:
            row[0] += 1.7e9


def _dated(draw: random.Random, rows: list[list[float]]) -> bytes:
    """The log with dates for times, of which some are wrong."""
    lines = ["time,y,u"]
    first = datetime.datetime(2026, 3, 29, 0, 59, 58, tzinfo=datetime.UTC)
    form = draw.choice(("%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%d %H:%M:%S.%f", "%H:%M:%S.%f", "%d.%m.%y"))
    for k, row in enumerate(rows):
        word = (first + datetime.timedelta(seconds=k * STEP)).strftime(form)
        if draw.random() < 0.01:
            word = draw.choice((*TEXTS, "2026-02-30T00:00:00", "0000-00-00", word[:-3])).strip("\n")
        lines.append(",".join([word, *map(repr, row[1:])]))
    return "\n".join(lines).encode()
