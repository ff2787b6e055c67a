"""Samples for `watch` and `estimate`: dialects, gaps, wrong readings, damaged bytes."""

from __future__ import annotations

import random
from typing import Any, Final

from tools.fuzz.case import Case
from tools.fuzz.damage import NUMBERS, bent
from tools.fuzz.scenarios import NAME, text

STEP: Final = 0.01
BASE: Final[dict[str, Any]] = {
    "plant": {"A": [[0.0, 1.0], [-4.0, -2.0]], "B": [[0.0], [4.0]], "C": [[1.0, 0.0]]},
    "sensor": {"noise": 0.01},
    "simulation": {"step": STEP, "time": "sampled"},
}
TOLD: Final = {"right": [0.1, 1.0]}
OBSERVERS: Final[tuple[dict[str, Any], ...]] = (
    {"method": "certified"},
    {"method": "kalman", **TOLD},
    {"method": "censored", **TOLD},
    {"method": "extended", **TOLD, "disturbance": 0.1},
    {"method": "ekf", **TOLD},
    {"method": "ukf", **TOLD},
    {"method": "adaptive_inverse"},
    {"method": "interval", **TOLD, "disturbance": 0.1},
)
HEADS: Final = ("t,y,u", "time [s];y [1];u [1]", "t\ty\tu", "u,t,y", "", "", "t,y", "y,u", "a,b,c")


def case(draw: random.Random) -> Case:
    """A log, mostly readable, for one of the observers."""
    observer = draw.choice(OBSERVERS[:3] if draw.random() < 0.7 else OBSERVERS)
    kind, data = "rows", log(draw)
    if draw.random() < 0.4:
        kind, data = "bytes", bent(draw, data)
    options = [word for word in ("--strict", "--json") if draw.random() < 0.3]
    if draw.random() < 0.2:
        options += ["--columns", draw.choice(("t=1,y=2,u=3", "y=y,u=u", "y=2", "x=1", "y=a,u=b"))]
    scenario = text(BASE | {"observer": observer})
    if draw.random() < 0.6:
        return Case(kind, {NAME: scenario}, ["watch", NAME, *options], data)
    files = {NAME: scenario, "log.csv": data}
    return Case(kind, files, ["estimate", NAME, "log.csv", "--no-figures", *options])


def log(draw: random.Random) -> bytes:
    """A log of some dialect."""
    rows = _rows(draw)
    head = draw.choice(HEADS)
    return written(draw, rows, head)


def _rows(draw: random.Random) -> list[list[float]]:
    """Times, readings and inputs of a hundred samples or fewer, some of them strange."""
    level = draw.choice((1.0, 1.0, 0.2, 5.0))
    y, rows = 0.0, []
    for k in range(draw.choice((0, 1, 2, 3, 30, 100))):
        u = level * (1 if (k // 25) % 2 == 0 else -1)
        y += STEP * 2 * (u - y)
        rows.append([k * STEP, y if abs(y) > 0.2 else 0.0, u])
    for _ in range(draw.choice((0, 0, 1, 2, 5))):
        if not rows:
            break
        row = draw.randrange(len(rows))
        act = draw.randrange(5)
        if act == 0:
            rows[row][draw.randrange(3)] = draw.choice(NUMBERS)
        elif act == 1:
            del rows[row]
        elif act == 2:
            rows.insert(draw.randrange(len(rows) + 1), list(rows[row]))
        elif act == 3:
            for later in rows[row:]:  # the clock jumps
                later[0] += draw.choice((0.1, 5.0, -0.5, 1e-4, 3600.0, -3600.0, 1e9))
        else:
            del rows[row : row + draw.randrange(60)]
    return rows


def written(draw: random.Random, rows: list[list[float]], head: str) -> bytes:
    """Rows as a file of some dialect."""
    separator = next((mark for mark in ";\t" if mark in head), draw.choice((",", ",", ";", " ")))
    end = draw.choice(("\n", "\n", "\r\n", "\r"))
    lines = [head.replace(",", separator) if draw.random() < 0.8 else head] if head else []
    for row in rows:
        cells = [repr(value) if value == value else draw.choice(("", "nan", "NA")) for value in row]
        if separator == ";" and draw.random() < 0.5:
            cells = [cell.replace(".", ",") for cell in cells]
        lines.append(separator.join(cells))
    data = (end.join(lines) + draw.choice((end, ""))).encode(draw.choice(("utf-8", "utf-8-sig")))
    return data.decode().encode("utf-16") if draw.random() < 0.03 else data
