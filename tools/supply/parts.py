"""The distributions that undeadzone needs, as they are installed here."""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Final

from packaging.requirements import Requirement

ROOT: Final = Path(__file__).parents[2]
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def normal(name: str) -> str:
    """A name as an index knows it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pinned() -> dict[str, str]:
    """The versions that constraints.txt names."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").split()
    return {normal(name): version for name, version in (line.split("==") for line in lines)}


def needed(requirements: list[str] | None = None) -> dict[str, Distribution]:
    """Every distribution that requirements bring, by name.

    Args:
        requirements: of a project; default: those of undeadzone without extras.
    """
    found: dict[str, Distribution] = {}
    open_ends = [Requirement(text) for text in requirements or PROJECT["dependencies"]]
    while open_ends:
        wanted = open_ends.pop()
        name = normal(wanted.name)
        if name not in found:
            found[name] = distribution(name)
            open_ends += _requirements(found[name], wanted.extras)
    return dict(sorted(found.items()))


def _requirements(owner: Distribution, extras: set[str]) -> list[Requirement]:
    """What a distribution requires on this machine."""
    every = [Requirement(text) for text in owner.requires or ()]
    chosen = [{"extra": extra} for extra in (*sorted(extras), "")]
    return [
        each
        for each in every
        if each.marker is None or any(each.marker.evaluate(extra) for extra in chosen)
    ]
