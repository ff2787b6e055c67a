"""`undeadzone arm` on URDF files: bombs, rings, what is missing, numbers that nobody builds."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Final

from tools.fuzz.case import Case, End
from tools.fuzz.damage import TEXTS, bent, number
from tools.fuzz.urdfs import ARM, SMALL, changed
from undeadzone.errors import UndeadzoneError
from undeadzone.plants.build import system
from undeadzone.scenario.reader import read

NAME: Final = "arm.urdf"
BOMB: Final = b'<!DOCTYPE b [<!ENTITY a "xxxxxxxxxx">%s]><robot name="&z;"/>' % b"".join(
    b'<!ENTITY %c "%s">' % (98 + k, (b"&%c;" % (97 + k)) * 10) for k in range(25)
)
OUTER: Final = b'<!DOCTYPE r [<!ENTITY f SYSTEM "file:///etc/passwd">]>'
INERTIAL: Final = (b"<inertial>", b"</inertial>")
MESH: Final = (
    b'<visual><geometry><mesh filename="package://no/such.stl"/></geometry></visual>',
    b'<collision><geometry><mesh filename="/dev/zero"/></geometry></collision>',
)
OPTIONS: Final = (
    ("--tip", "b"),
    ("--tip", "tool0"),
    ("--tip", "nowhere"),
    ("--joints", "j"),
    ("--joints", "elbow_joint,wrist_1_joint"),
    ("--joints", "x,,y"),
    ("--at", "0.1"),
    ("--at", "nan"),
    ("--at", "1e300"),
    ("--at", "0,0,0,0,0,0"),
    ("--out", "out"),
    ("--json",),
)


def case(draw: random.Random) -> Case:
    """A file that is wrong in one way or several, and the command."""
    kind = draw.choice(
        ("structure", "structure", "bytes", "entities", "missing", "ring", "numbers")
    )
    base = ARM if draw.random() < 0.2 else SMALL
    content = {
        "structure": lambda: changed(draw, base),
        "bytes": lambda: bent(draw, base),
        "entities": lambda: _with_entities(draw, base),
        "missing": lambda: _without(draw, base),
        "ring": lambda: _ring(draw),
        "numbers": lambda: _numbers(draw, base),
    }[kind]()
    words = ["arm", NAME]
    for option in draw.sample(OPTIONS, draw.choice((0, 1, 2))):
        words += option
    return Case(kind, {NAME: content}, words, judged=_left)


def _left(folder: Path, end: End) -> str:
    """What is wrong with the scenario that it wrote."""
    out = folder / "out"
    files = list(out.rglob("*")) if out.exists() else []
    if end.code == 2 and files:
        return f"written, and refused: {files[0].name}"
    for path in files:
        try:
            system(read(path).plant)
        except UndeadzoneError as error:
            return f"its scenario: {error}"
    return ""


def _with_entities(draw: random.Random, base: bytes) -> bytes:
    """Entities that grow, name files, or are not there."""
    act = draw.randrange(4)
    if act == 0:
        return BOMB
    if act == 1:
        return OUTER + base.replace(b'name="r"', b'name="&f;"')
    if act == 2:
        return base.replace(b"<link", b"&f;<link", 1)
    return b"<a>" * draw.choice((10, 5_000, 100_000)) + base


def _without(draw: random.Random, base: bytes) -> bytes:
    """A part is gone, or names what is not there."""
    act = draw.randrange(4)
    if act == 0:
        start = base.find(INERTIAL[0])
        return base[:start] + base[base.find(INERTIAL[1], start) + len(INERTIAL[1]) :]
    if act == 1:
        return base.replace(b"</link>", b"".join(MESH) + b"</link>")
    word = draw.choice(
        (b"<limit", b"<axis", b"<origin", b"<mass", b"<inertia ", b"<parent", b"<child")
    )
    places = [k for k in range(len(base)) if base.startswith(word, k)]
    start = draw.choice(places)
    end = base.index(b"/>", start) + 2
    return base[:start] + (base[start:end] * 2 if act == 3 else b"") + base[end:]


def _ring(draw: random.Random) -> bytes:
    """Links that carry each other, themselves, or one that two carry; or a long chain."""
    count = draw.choice((1, 2, 3, 8))
    names = [f"l{k}" for k in range(count)]
    pairs = [(names[k], names[(k + 1) % count]) for k in range(count)]
    if draw.random() < 0.5:
        pairs = [(draw.choice(names), draw.choice(names)) for _ in range(draw.choice((1, 3, 9)))]
    links = "".join(f'<link name="{name}"/>' for name in names)
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="{a}"/><child link="{b}"/></joint>'
        for k, (a, b) in enumerate(pairs)
    )
    return f'<robot name="ring">{links}{joints}</robot>'.encode()


def _numbers(draw: random.Random, base: bytes) -> bytes:
    """Attributes that are no number, or none of this world."""
    pieces = base.split(b'"')
    numeric = [k for k in range(1, len(pieces), 2) if _is_number(pieces[k])]
    for k in draw.sample(numeric, draw.choice((1, 1, 3))):
        word = draw.choice(TEXTS) if draw.random() < 0.2 else repr(number(draw))
        clean = word.translate({ord(mark): None for mark in '"<&\n\x1b'})
        pieces[k] = b" ".join([clean.encode()] * len(pieces[k].split()))
    return b'"'.join(pieces)


def _is_number(word: bytes) -> bool:
    """Whether an attribute holds numbers."""
    return word.strip(b" -+.0123456789e") == b"" and bool(word.strip())
