"""Scenarios of the arena: TOML files in folders, a tuning set and a held-out set each.

Besides dead zones of a sensor there are plays, and dead zones at both ends.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib.resources import as_file, files
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal

from undeadzone.errors import InputError
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario

Kind = Literal["tuning", "held_out", "plays_tuning", "plays", "both_ends_tuning", "both_ends"]
SETS: Final[Mapping[str, tuple[Kind, Kind]]] = MappingProxyType(
    {
        "dead_zones": ("tuning", "held_out"),
        "plays": ("plays_tuning", "plays"),
        "both_ends": ("both_ends_tuning", "both_ends"),
    }
)  # each: to tune on, held out


def arena_scenarios(kind: Kind) -> dict[str, Scenario]:
    """Read the arena's own scenarios, by file name without its suffix.

    Each method takes the place of their observer.
    """
    with as_file(files("undeadzone_arena.contest") / "scenarios" / kind) as folder:
        return {path.stem: read(path) for path in sorted(folder.glob("*.toml"))}


def scenarios_from_files(
    paths: Sequence[str | os.PathLike[str]], confine: Path | None = None
) -> dict[str, Scenario]:
    """Read a user's scenarios, by file name without its suffix. Raises FileError, InputError.

    Args:
        paths: of the files.
        confine: a folder outside of which they may name no file (None: any).
    """
    own = {Path(path).stem: read(path, confine) for path in paths}
    if len(own) < len(paths):
        raise InputError("arena: two scenarios have the same file name. Rename one")
    return own
