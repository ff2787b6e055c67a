"""What is expensive and asked for by several files of tests: made once a process.

`conftest.TOGETHER` keeps such files in one process.
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from undeadzone.analysis.certificate.design_file import Design
from undeadzone.scenario.schema import Scenario
from undeadzone.util import toml
from undeadzone_design.synthesis import gain_search
from undeadzone_design.synthesis.design import Aim
from undeadzone_design.synthesis.design import design as search
from undeadzone_export import compiler
from undeadzone_paper import Paper
from undeadzone_paper import audit as audited


@functools.cache
def nodes(text: str) -> list[ast.AST]:
    """All nodes of a Python text, as `ast.walk` gives them."""
    return list(ast.walk(ast.parse(text)))


def program(words: list[str], folder: Path) -> Path:
    """A program, the first of the words, of C in a folder; `conftest.compiled_once` keeps it.

    Args:
        words: its name, then gcc's options and the names of the files.
        folder: where they are.
    """
    name, *more = words
    done = compiler._run_compiler(["gcc", *more, "-o", name, "-lm"], folder)
    assert done.returncode == 0, done.stderr
    return folder / name


HASTY = {"STARTS": 2, "SHORT": 30, "LONG": 100, "ROUNDS": 40}
_designs: dict[Any, Design] = {}


def in_haste(patch: pytest.MonkeyPatch) -> None:
    """Designs look at a fifth of the points: where the last percent is not what a test is about."""
    for name, length in HASTY.items():
        patch.setattr(gain_search, name, length)


def design(
    scenario: Scenario,
    maximise: Aim = "knee",
    *,
    margin: float = 0.01,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Design:
    """`undeadzone.design`, the same task once; progress is told of the first."""
    task = toml.to_toml(scenario), maximise, margin, seed
    if task not in _designs:
        _designs[task] = search(scenario, maximise, margin=margin, seed=seed, progress=progress)
    return _designs[task]


@functools.cache
def audit() -> tuple[Paper, list[int]]:
    """The paper, audited, and what its progress was told."""
    progress: list[int] = []
    return audited(progress.append), progress
