"""Frozen answers as files: one for each family, one line for each case."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from .compare import Case

FOLDER = Path(__file__).with_name("answers")
Writes = list[list[str]]


class Frozen(NamedTuple):
    """Frozen answers of a family.

    Attributes:
        written: date, commit and reason of each write, the last one last.
        cases: by name.
    """

    written: Writes
    cases: dict[str, Case]


def read_frozen(family: str, folder: Path | None = None) -> Frozen:
    """Return the frozen answers of a family; none where nothing was written.

    Args:
        family: its name.
        folder: of the files; None: that of this repository.
    """
    path = (folder or FOLDER) / f"{family}.json"
    if not path.exists():
        return Frozen([], {})
    stored = json.loads(path.read_text(encoding="utf-8"))
    cases = stored["cases"].items()
    return Frozen(
        stored["written"],
        {name: Case(one["answer"], one["truth"], one["cpu"]) for name, one in cases},
    )


def write_frozen(family: str, frozen: Frozen, folder: Path | None = None) -> None:
    """Write the frozen answers of a family.

    Args:
        family: its name.
        frozen: answers.
        folder: of the files; None: that of this repository.
    """
    rows = [
        f"{_dump(name)}:{_dump({'answer': one.fields, 'cpu': one.cpu, 'truth': one.truth})}"
        for name, one in sorted(frozen.cases.items())
    ]
    writes = [_dump(one) for one in frozen.written]
    text = '{"written":[\n' + ",\n".join(writes) + '\n],\n"cases":{\n' + ",\n".join(rows) + "\n}}\n"
    path = (folder or FOLDER) / f"{family}.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _dump(value: Any) -> str:
    """Return a value as compact JSON."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
