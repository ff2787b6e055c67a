"""Tests that only `make long` runs name a test of `make test` that fails if their kind breaks."""

from __future__ import annotations

import ast
import datetime
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from benchmarks.end_to_end.long_tests import to_table

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


def test_the_table_of_long_tests_counts_failures_by_file() -> None:
    text = """<testsuite>
      <testcase classname="tests.a.test_odds" name="test_one"><properties>
        <property name="start" value="1.5"/><property name="cpu" value="2.5"/>
      </properties></testcase>
      <testcase classname="tests.a.test_odds" name="test_two"><failure message="no"/></testcase>
      <testcase classname="tests.b.test_play" name="test_three"><error message="no"/></testcase>
    </testsuite>"""
    lines = to_table([*ET.fromstring(text)], datetime.date(2026, 11, 28)).splitlines()
    assert lines[2] == "On 2026-11-28."
    assert lines[6:9] == ["| odds | 2 | 1 | 4 |", "| play | 1 | 1 | 0 |", "| all | 3 | 2 | 4 |"]
    assert lines[-1] == "Failed: odds: `test_two`, play: `test_three`."
