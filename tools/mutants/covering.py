"""Which test runs which line, and at what cost: noted once by coverage.py.

As a plug-in of pytest this file notes the cost of each test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

COSTS = "MUTANTS_COSTS"  # environment: the file of costs


class Covering(NamedTuple):
    """The map.

    Attributes:
        costs: of each test [s] of processor time.
        data: of coverage.py.
        source: folder of all packages.
    """

    costs: dict[str, float]
    data: Any
    source: Path

    def tests(self, file: str, line: int) -> list[str]:
        """The tests that run a line of a file."""
        contexts = self.data.contexts_by_lineno(str(self.source / file)).get(line, [])
        names = {context.rpartition("|")[0] for context in contexts}
        return sorted(name for name in names if name in self.costs)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note what a test costs."""
    began = time.process_time()
    result = yield
    if COSTS in os.environ:
        with open(os.environ[COSTS], "a", encoding="utf-8") as file:
            file.write(json.dumps([item.nodeid, time.process_time() - began]) + "\n")
    return result


def noted(root: Path, folder: Path, options: list[str]) -> None:
    """Run tests and note what they cover; what was noted of others stays.

    Args:
        root: of the repository.
        folder: of the map.
        options: of pytest: files of tests, `-m "not slow and not long"`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {COSTS: str(folder / "costs"), "COVERAGE_FILE": str(folder / "data")}
    words = ["--cov=src", "--cov-context=test", "--cov-append", "--cov-report="]
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "tools.mutants.covering",
        *words,
        *options,
    ]
    done = subprocess.run(command, cwd=root, env=environment, check=False)
    if done.returncode not in (0, 1):  # 1: a test failed, which a trial finds out by itself
        sys.exit(f"pytest ended with {done.returncode}")


def read(source: Path, folder: Path) -> Covering:
    """What was noted."""
    import coverage

    costs: dict[str, float] = {}
    for text in (folder / "costs").read_text(encoding="utf-8").splitlines():
        test, cost = json.loads(text)
        costs[test] = cost
    data = coverage.CoverageData(str(folder / "data"))
    data.read()
    return Covering(costs, data, source)
