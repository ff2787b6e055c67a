"""The commit that a table was made at, and shares with their intervals."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from undeadzone.util.arrays import Floats
from undeadzone_studies.statistics.intervals import proportion


def commit() -> str:
    """Name the commit of the code, with a plus if the code differs from it."""
    named = ["git", "describe", "--always"]
    revision = subprocess.run(named, capture_output=True, text=True, check=True).stdout.strip()
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "*.py"], check=False)
    return revision + "+" * bool(changed.returncode)


def load_or_compute(
    folder: Path | None, name: str, compute: Callable[[], Iterable[Floats]]
) -> Iterable[Floats]:
    """What is computed, from the folder if it is there already."""
    if folder is None:
        return compute()
    path = folder / f"{name}.npz".replace(" ", "_")
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, *compute())
        print(path.name, file=sys.stderr, flush=True)
    with np.load(path) as arrays:
        return list(arrays.values())


def share(flags: Iterable[bool]) -> str:
    """Write a share with its 95 % interval."""
    every = list(flags)
    if not every:
        return "-"
    value, low, high = proportion(sum(every), len(every))
    return f"{value:.3f} [{low:.3f}, {high:.3f}] of {len(every)}"
