"""The scenarios of the arena: TOML files in two folders, one to tune on, the other held out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Literal

from undeadzone.errors import InputError
from undeadzone.scenario.reader import read
from undeadzone.scenario.schema import Scenario


def scenarios(kind: Literal["tuning", "held_out"]) -> dict[str, Scenario]:
    """The arena's own scenarios, by file name without its suffix.

    Each method takes the place of their observer.
    """
    with as_file(files("undeadzone.arena") / "scenarios" / kind) as folder:
        return {path.stem: read(path) for path in sorted(folder.glob("*.toml"))}


def from_files(
    paths: Sequence[str | os.PathLike[str]], confine: Path | None = None
) -> dict[str, Scenario]:
    """Scenarios of one's own, by file name without its suffix. Raises FileError, InputError.

    Args:
        paths: of the files.
        confine: a folder outside of which they may name no file; None: any.
    """
    own = {Path(path).stem: read(path, confine) for path in paths}
    if len(own) < len(paths):
        raise InputError("arena: two scenarios have the same file name; rename one")
    return own
