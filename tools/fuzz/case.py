"""An input, and what became of it."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple


class Case(NamedTuple):
    """One input, ready to be run in an empty folder.

    Attributes:
        kind: of the input, for the table.
        files: contents by name, relative to the folder.
        command: words of a command line; None: `call` is run.
        stdin: of the command.
        call: takes the folder; it may raise errors of undeadzone alone.
        made: puts into the folder what is no plain file.
        inside: of the folder, where the command runs.
        apart: whether it runs in a process of its own: "forked" from this one, or "started".
        settings: of the environment, where it is started.
        judged: takes the folder once the case has ended; what is wrong with what it left.
    """

    kind: str
    files: Mapping[str, bytes]
    command: Sequence[str] | None = None
    stdin: bytes = b""
    call: Callable[[Path], object] | None = None
    made: Callable[[Path], None] | None = None
    inside: str = "."
    apart: Literal["", "forked", "started"] = ""
    settings: Mapping[str, str] = MappingProxyType({})
    judged: Callable[[Path, End], str] | None = None


class End(NamedTuple):
    """How a case ended.

    Attributes:
        code: exit code of the command; 0 or 2 for a call.
        out: what it printed on stdout.
        err: what it printed on stderr.
        native: what libraries wrote past Python.
        left: what is wrong with what it left in its folder.
    """

    code: int
    out: str
    err: str
    native: str = ""
    left: str = ""


Maker = Callable[[random.Random], Case]


def stream(name: str, seed: int, index: int) -> random.Random:
    """The random numbers of one case, the same on every machine."""
    return random.Random(f"{name} {seed} {index}")
