"""Tests that only `make long` runs name a test of `make test` that fails if their kind breaks."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]


def read_marks(text: str) -> dict[str, str | None]:
    """Return the sentinel of each test of a text; None: `make test` runs it, "": none is named."""
    sentinels: dict[str, str | None] = {}
    for node in ast.parse(text).body:
        if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test"):
            continue
        sentinels[node.name] = None
        for mark in node.decorator_list:
            if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "pytest.mark.long":
                sentinels[node.name] = ast.literal_eval(mark.args[0])
            elif ast.unparse(mark) == "pytest.mark.long":
                sentinels[node.name] = ""
    return sentinels


def find_missing(files: dict[str, str]) -> list[str]:
    """Return the tests whose sentinel does not exist or is left out by `make test` itself.

    Args:
        files: text of each file of tests by its path. A sentinel of another file is PATH::NAME.
    """
    marks = {path: read_marks(text) for path, text in files.items()}
    missing = []
    for path, sentinels in marks.items():
        for test, sentinel in sentinels.items():
            if sentinel is None:
                continue
            file, _, name = sentinel.rpartition("::")
            own = marks.get(file or path, {})
            if name not in own or own[name] is not None:
                missing.append(f"{path}::{test}")
    return missing


def test_every_long_test_has_a_sentinel() -> None:
    files = {}
    for path in TESTS.rglob("test_*.py"):
        files[str(path.relative_to(TESTS))] = path.read_text(encoding="utf-8")
    assert find_missing(files) == []


@pytest.mark.parametrize(
    ("mark", "missing"),
    [
        ("@pytest.mark.long('test_short')", []),
        ("@pytest.mark.long('b.py::test_other')", []),
        ("@pytest.mark.long('test_gone')", ["a.py::test_row"]),
        ("@pytest.mark.long('test_row')", ["a.py::test_row"]),
        ("@pytest.mark.long", ["a.py::test_row"]),
    ],
)
def test_a_missing_sentinel_is_found(mark: str, missing: list[str]) -> None:
    text = f"def test_short(): pass\n{mark}\ndef test_row(): pass\n"
    assert find_missing({"a.py": text, "b.py": "def test_other(): pass\n"}) == missing
