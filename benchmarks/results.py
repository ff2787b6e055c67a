"""The commit that a table was made at, and shares with their intervals."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable

from undeadzone_studies.statistics.intervals import proportion


def commit() -> str:
    """Name the commit of the code, with a plus if the code differs from it."""
    named = ["git", "describe", "--always"]
    revision = subprocess.run(named, capture_output=True, text=True, check=True).stdout.strip()
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "*.py"], check=False)
    return revision + "+" * bool(changed.returncode)


def share(flags: Iterable[bool]) -> str:
    """Write a share with its 95 % interval."""
    every = list(flags)
    if not every:
        return "-"
    value, low, high = proportion(sum(every), len(every))
    return f"{value:.3f} [{low:.3f}, {high:.3f}] of {len(every)}"
