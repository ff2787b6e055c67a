"""Answers of studies of hours, which are kept as soon as they are there and not computed again.

So a study can be done in parts, and by several processes at once.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from undeadzone.util.progress import terminal_progress

Outcome = dict[str, Any]


def read_answers(path: Path, of: str | None, *keys: str) -> dict[tuple[Any, ...], Outcome]:
    """The answers of a commit that a file holds, by their keys; a torn line is none."""
    stored = {}
    for line in path.read_text().splitlines():
        try:
            one = json.loads(line)
        except ValueError:
            continue
        if one.get("commit") == of:
            stored[tuple(one[key] for key in keys)] = one
    return stored


def complete(
    path: Path,
    of: str | None,
    keys: Sequence[str],
    pending: Sequence[tuple[Any, ...]],
    ask: Callable[..., Outcome],
    minutes: str = "inf",
) -> list[Outcome]:
    """Every answer of a commit, after as many new ones as the time allows.

    Args:
        path: the file that keeps them.
        of: the commit; none if the file has none.
        keys: names of what tells answers apart.
        pending: the keys of the answers that are asked for.
        ask: gives an answer by its keys.
        minutes: how long it may ask.
    """
    path.parent.mkdir(exist_ok=True)
    path.touch()
    ends = time.monotonic() + 60 * float(minutes)
    with terminal_progress("logs", len(pending), "log") as advance:
        for key in pending:
            if time.monotonic() < ends and key not in read_answers(path, of, *keys):
                answer = dict(zip(keys, key, strict=True)) | ask(*key) | {"commit": of}
                with path.open("a") as file:
                    file.write(json.dumps(answer) + "\n")
            advance(1)
    return list(read_answers(path, of, *keys).values())
