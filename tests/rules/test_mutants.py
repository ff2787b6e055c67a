"""`make mutants` tells what tests notice from what they do not, and a trial that did not run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TRIAL = """
import sys
from pathlib import Path

import hypothesis
import undeadzone.util.text
from tools.mutants.changes import mutant, places
from tools.mutants.trial import noticed

source, file = Path("src").resolve(), "undeadzone/util/text.py"
place = next(place for place in places(source, file) if place.what.startswith("HALF_95 * std"))
print(*noticed(file, mutant(source, place), sys.argv[1:], 3.0))
"""
NOTICES = """
from undeadzone.util.text import format_with_interval


def test_an_interval():
    assert format_with_interval(1.0, 0.1) == "1.00 [0.80, 1.20]"
"""


def tried(*tests: Path) -> subprocess.CompletedProcess[str]:
    """A mutant of the half width of an interval, before some files of tests."""
    command = [sys.executable, "-c", TRIAL, *map(str, tests)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(
    ("test", "result"),
    [(NOTICES, "True test_it.py::test_an_interval"), ("def test_nothing(): pass", "False")],
)
def test_a_mutant_is_noticed_by_a_test_of_what_it_changes(
    tmp_path: Path, test: str, result: str
) -> None:
    file = tmp_path / "test_it.py"
    file.write_text(test)
    noticed, _, first = tried(file).stdout.strip().partition(" ")
    assert f"{noticed} {first.rpartition('/')[2]}".strip() == result


def test_a_trial_that_does_not_run_is_no_mutant_noticed(tmp_path: Path) -> None:
    done = tried(tmp_path / "test_missing.py")
    assert done.returncode == 1
    assert "RuntimeError: undeadzone/util/text.py: exit 4 before the first test" in done.stderr
