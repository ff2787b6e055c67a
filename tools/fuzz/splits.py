"""Live logs in random pieces: whatever the bytes and their faults, the same comes out."""

from __future__ import annotations

import functools
import random
from pathlib import Path

from tests.live import KALMAN, WRONG_LINES, fed, line, regular

from tools.fuzz.case import Case
from tools.fuzz.damage import bent
from tools.fuzz.streams import log

NAME = "lever.toml"


def case(draw: random.Random) -> Case:
    """A log, as one piece, in many, and byte by byte where it is short."""
    kind, data = ("dialects", log(draw)) if draw.random() < 0.3 else ("faults", _faulty(draw))
    if draw.random() < 0.3:
        kind, data = "bytes", bent(draw, data)
    counts = [draw.choice((1, 2, 5, 60)), 400]
    cuts = [[draw.randrange(len(data) + 1) for _ in range(count)] for count in counts]
    if len(data) < 2000:
        cuts.append(list(range(len(data))))
    strict = draw.random() < 0.3
    files = {NAME: KALMAN.encode()}
    return Case(kind, files, call=functools.partial(_the_same, data, cuts, strict))


def _faulty(draw: random.Random) -> bytes:
    """Lines of which some are wrong, twice or gone, and times that jump."""
    lines = [line(t) for t in regular(draw.choice((5, 40, 120)))]
    for _ in range(draw.choice((0, 1, 3, 10))):
        place = draw.randrange(len(lines) + 1)
        fault = draw.choice((*WRONG_LINES, line(draw.uniform(-1, 2)), line(draw.uniform(0, 1e6))))
        lines[place : place + draw.choice((0, 1, 1, 5))] = [fault]
    if draw.random() < 0.3:
        place = draw.randrange(len(lines) + 1)
        lines[place:place] = [line(t) for t in regular(30, draw.choice((0.0, 7.0, 1e4)))]
    return b"t,y,u\n" + b"".join(lines)


def _the_same(data: bytes, cuts: list[list[int]], strict: bool, folder: Path) -> None:
    """Feed a log to as many observers."""
    whole = fed(folder / NAME, data, [], strict)
    for places in cuts:
        assert fed(folder / NAME, data, places, strict) == whole, "it depends on the pieces"
