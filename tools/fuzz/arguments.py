"""Paths that arguments and options name: each command, each of its paths, links, pipes and names.

Half of the commands have --untrusted. What leads out of DIR is neither read, told nor replaced.
"""

from __future__ import annotations

import functools
import itertools
import os
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import click
from tests.traps import SHORT

from tools.fuzz.case import Case, End
from tools.fuzz.folders import HOME, OUT, SECRET, STRANGE, seen
from tools.fuzz.identify_logs import sound
from tools.fuzz.urdfs import SMALL
from undeadzone.cli import group
from undeadzone.cli.common import UserPath

SECRETS: Final = {
    "secret.csv": f"t,u,y,{SECRET}\n0.0,1.0,2.0,3\n",
    "secret.toml": SHORT.replace('"short"', f'"{SECRET}"'),
    "secret.urdf": f"<robot name='{SECRET}'/>",
    "secret.npz": f"PK{SECRET}",
    "secret": f"password = {SECRET}\n",
}
# What a path is: a file of the right kind, of another one, or something else.
READ: Final = (
    *("right", "right", "right", "linked", "hard", "linked folder", "above", "absolute", "device"),
    *("pipe", "folder", "loop", "missing", "other", "own link", "exchanged", "descriptor", "long"),
)
WRITTEN: Final = (
    *("new", "new", "deep", "linked", "linked folder", "above", "pipe", "file", "loop", "long"),
    *("own link", "inside", "bare link"),
)
RIGHT: Final = {"SCENARIO.toml": "s.toml", "LOG": "log.csv", "ROBOT.urdf": "arm.urdf"}
MORE: Final[Mapping[str, Sequence[str]]] = {
    "ensemble": ("--runs", "2"),
    "identify": ("--order", "1"),
    "tune": ("--budget", "2", "--runs", "2"),
    "arena": ("--methods", "kalman", "--seeds", "1", "--processes", "1"),
    "watch": (),
}
QUICK: Final = (
    *("run", "run", "check", "watch", "estimate", "estimate", "identify", "identify", "arm"),
    *("export", "export", "ensemble", "init"),
)
# These take long where all is right: one of their paths is not.
SLOW: Final = ("tune", "arena", "design", "paper")


def case(draw: random.Random) -> Case:
    """A command whose paths are right or not."""
    name = draw.choice(QUICK) if draw.random() < 0.85 else draw.choice(SLOW)
    command = group.get_command(click.Context(group), name)
    assert command is not None
    first: list[str] = []
    words: list[str] = []
    kinds = []
    untrusted = draw.random() < 0.6 and any(each.name == "untrusted" for each in command.params)
    for parameter in command.params:
        if not isinstance(parameter.type, UserPath) or parameter.name in ("untrusted", "confine"):
            continue
        is_option = isinstance(parameter, click.Option)
        if is_option and parameter.name != "out" and draw.random() < 0.5:
            continue
        if not is_option and name == "arena" and draw.random() < 0.1:
            continue
        kind = draw.choice(READ if parameter.type.use.startswith("read") else WRITTEN)
        if name in SLOW and not kinds:
            kind = draw.choice(("pipe", "loop"))
        kinds.append(kind)
        path = _path(draw, kind, _right(parameter))
        first += [] if is_option else [path]
        words += [parameter.opts[0], path] if is_option else []
    words += MORE.get(name, ())
    if any(each.name == "no_figures" for each in command.params):
        words.append("--no-figures")
    if untrusted:
        words += ["--untrusted", STRANGE]
    before: dict[str, tuple[object, ...]] = {}
    return Case(
        f"{name}{', untrusted' if untrusted else ''}",
        _files(draw),
        [name, *first, *words],
        stdin=_log(draw).encode() if name == "watch" else b"",
        made=functools.partial(_made, before),
        apart="forked",
        judged=functools.partial(_left, before, untrusted, _is_out_above(words)),
    )


def _is_out_above(words: Sequence[str]) -> bool:
    """Return whether the user's own --out is the folder above the stranger's."""
    return ("--out", f"{STRANGE}/..") in itertools.pairwise(words)


def _right(parameter: click.Parameter) -> str:
    """The file that a parameter wants."""
    metavar = (parameter.metavar or "").strip("[]").split()[0]
    named = {"--state": "state.npz", "--tuned": "tuned.toml", "--animation": "film.gif"}
    return RIGHT.get(metavar, named.get(parameter.opts[0], "made.csv"))


def _path(draw: random.Random, kind: str, right: str) -> str:
    """A path of a kind, from the folder above the stranger's."""
    suffix = Path(right).suffix
    return {
        "right": f"{STRANGE}/{right}",
        "linked": f"{STRANGE}/linked{suffix}",
        "hard": f"{STRANGE}/hard{suffix}",
        "linked folder": f"{STRANGE}/way/secret{suffix}",
        "above": f"{STRANGE}/../{HOME}/secret{suffix}" if draw.random() < 0.5 else f"{STRANGE}/..",
        "absolute": "/etc/hostname",
        "device": draw.choice(("/dev/null", "/dev/zero", "/dev/urandom")),
        "pipe": f"{STRANGE}/pipe{suffix}",
        "folder": STRANGE,
        "loop": f"{STRANGE}/loop{suffix}",
        "missing": f"{STRANGE}/missing{suffix}",
        "other": f"{STRANGE}/{draw.choice(('s.toml', 'log.csv', 'arm.urdf', 'words'))}",
        "own link": f"{STRANGE}/own{suffix}",
        "exchanged": f"{STRANGE}/./in/../linked{suffix}",
        "descriptor": "/proc/self/fd/0",
        "long": f"{STRANGE}/{'x' * draw.choice((250, 5000))}{suffix}",
        "new": f"{OUT}/{right}",
        "deep": f"{OUT}/a/b/c/{right}",
        "file": f"{STRANGE}/words/x{suffix}",
        "inside": f"{STRANGE}/new/{right}",
        "bare link": f"{STRANGE}/way",
    }[kind]


def _files(draw: random.Random) -> dict[str, bytes]:
    """What the stranger and the user have."""
    there = {"s.toml": SHORT, "log.csv": _log(draw), "arm.urdf": SMALL.decode(), "words": "x\n"}
    files = {f"{STRANGE}/{name}": text.encode() for name, text in there.items()}
    return files | {f"{HOME}/{name}": text.encode() for name, text in SECRETS.items()}


def _log(draw: random.Random) -> str:
    """A log of a few samples."""
    rows = [",".join(map(repr, row)) for row in sound(draw, draw.choice((5, 110)))]
    return "\n".join(["t,y,u", *rows]) + "\n"


def _made(before: dict[str, tuple[object, ...]], folder: Path) -> None:
    """Put links and pipes into the stranger's folder; remember what is there."""
    strange = folder / STRANGE
    (strange / "in").mkdir()
    (strange / "way").symlink_to(f"../{HOME}")
    for suffix in ("", ".csv", ".toml", ".urdf", ".npz", ".gif"):
        secret = folder / HOME / f"secret{suffix}"
        (strange / f"linked{suffix}").symlink_to(f"../{HOME}/secret{suffix}")
        if secret.exists():
            os.link(secret, strange / f"hard{suffix}")
        os.mkfifo(strange / f"pipe{suffix}")
        (strange / f"loop{suffix}").symlink_to(f"loop{suffix}")
    for own in ("s.toml", "log.csv", "arm.urdf"):
        (strange / f"own{Path(own).suffix}").symlink_to(own)
    before.update(seen(folder / HOME, links=True))


def _left(
    before: dict[str, tuple[object, ...]], untrusted: bool, above: bool, folder: Path, end: End
) -> str:
    """What was told or replaced that is elsewhere.

    Args:
        before: kind and content of each file of the user.
        untrusted: whether the command distrusts the stranger's folder.
        above: whether the user named the folder above it for results.
        folder: above it.
        end: of the command.
    """
    after = seen(folder / HOME, links=True)
    replaced = [name for name in before if before[name] != after.get(name)]
    if replaced:
        return f"replaced elsewhere: {replaced}"
    if not untrusted:
        return ""
    if before.keys() != after.keys():
        return f"written elsewhere: {sorted(after.keys() - before.keys())}"
    if above:
        return ""  # --out may be read and written, and all these folders are in it
    if SECRET in end.out + end.err:
        return "it tells what stands in files elsewhere"
    outside = {path.name for path in folder.iterdir()} - {STRANGE, HOME, OUT}
    return f"written beside --out: {sorted(outside)}" if outside else ""
