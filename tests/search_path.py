"""Folders that pytest puts on Python's path, for programs that import tests without it."""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def add_test_folders(root: Path = ROOT) -> None:
    """Put the folders that pyproject.toml lists ahead of all others.

    Args:
        root: of the repository.
    """
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    listed = settings["tool"]["pytest"]["ini_options"]["pythonpath"]
    sys.path[:0] = [str(root / name) for name in listed if str(root / name) not in sys.path]
