"""Damage to bytes, text and numbers, as transport, editors and people do it."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

NUMBERS: Sequence[float] = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    0.5,
    2.0,
    1e-3,
    -3.7,
    100.0,
    1e6,
    -1e6,
    1e-9,
    1e12,
    1e-30,
    1e30,
    1e49,
    -1e49,
    1e-300,
    5e-324,
    1e300,
    float("nan"),
    float("inf"),
    -float("inf"),
)
TEXTS: Sequence[str] = (
    "",
    " ",
    "x",
    "0",
    "nan",
    "sine",
    "kalman",
    "ä∞",
    "a\nb",
    "\x1b[2J",
    "\u202e",
    "$x$",
    "../../etc/passwd",
    "/dev/zero",
    ".",
    "x" * 300,
    "{0}",
    "%s",
    "1e400",
    "-1",
)


def number(draw: random.Random) -> float | int:
    """A number as people and programs write them, and as nobody should."""
    kind = draw.randrange(5)
    if kind == 0:
        return draw.choice((0, 1, -1, 2, 3, 7, 100, -5, 2**31, 2**53 + 1, 2**62, -(2**63)))
    if kind == 1:
        return draw.choice(NUMBERS)
    if kind == 2:
        return draw.uniform(-10, 10)
    size = 10.0 ** draw.uniform(-6, 6)
    return draw.choice((size, -size, size, size))


def anything(draw: random.Random, depth: int = 0) -> Any:
    """A value of any type that TOML and JSON know."""
    kind = draw.randrange(8 if depth < 3 else 5)
    if kind < 2:
        return number(draw)
    if kind == 2:
        return draw.choice(TEXTS)
    if kind == 3:
        return draw.random() < 0.5
    if kind == 4:
        return draw.choice(([], {}, [[]], [[], []], [0.0] * 40, "text"))
    if kind == 5:
        return {draw.choice(TEXTS) or "key": anything(draw, depth + 1)}
    return [anything(draw, depth + 1) for _ in range(draw.randrange(4))]


def bent(draw: random.Random, data: bytes) -> bytes:
    """Bytes with a few places damaged."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 3, 10))):
        place = draw.randrange(len(changed) + 1)
        length = draw.choice((1, 1, 2, 8, 100))
        kind = draw.randrange(6)
        if kind == 0:
            del changed[place : place + length]
        elif kind == 1:
            changed[place:place] = bytes(draw.randrange(256) for _ in range(length))
        elif kind == 2 and place < len(changed):
            changed[place] ^= 1 << draw.randrange(8)
        elif kind == 3:
            changed[place:place] = changed[place : place + length]
        elif kind == 4:
            word = draw.choice(
                (*TEXTS, *map(repr, NUMBERS), "[", "]", "{", "}", '"', "=", ",", "\n")
            )
            changed[place : place + length] = word.encode()
        else:
            del changed[place:]
    return bytes(changed)
