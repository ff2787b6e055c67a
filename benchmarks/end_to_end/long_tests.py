"""Tests that only `make long` runs: rows of statistics, and further strangers of each kind.

Each stands beside a sentinel in `make test` (tests/rules/test_sentinels.py).
"""

from __future__ import annotations

import datetime
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path

from benchmarks.markdown import head, row

ROOT = Path(__file__).parents[2]


def table() -> str:
    """Run the tests and count them by file."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-n", "2", "-m", "long", f"--junitxml={report}"]
        subprocess.run(command, cwd=ROOT, check=False, stdout=sys.stderr)
        cases = ET.parse(report).getroot().iter("testcase")
        return to_table(list(cases), datetime.date.today())


def to_table(cases: list[ET.Element], day: datetime.date) -> str:
    """Return the tests, failures and CPU seconds of each file, and the names of failed tests."""
    counts, failures, seconds = Counter[str](), Counter[str](), Counter[str]()
    names = []
    for case in cases:
        file = str(case.get("classname")).rpartition(".test_")[2]
        counts[file] += 1
        if case.find("failure") is not None or case.find("error") is not None:
            failures[file] += 1
            names.append(f"{file}: `{case.get('name')}`")
        for entry in case.iter("property"):
            if entry.get("name") in ("start", "cpu", "end"):
                seconds[file] += float(str(entry.get("value")))
    for each in (counts, failures, seconds):
        each["all"] = each.total()
    rows = head("file", "tests", "failed", "CPU s")
    for file in sorted(counts, key=lambda name: (name == "all", name)):
        rows.append(row(file, *(f"{each[file]:.0f}" for each in (counts, failures, seconds))))
    failed = ["", "Failed: " + ", ".join(names) + "."] if names else []
    return "\n".join(["## Long tests", "", f"On {day:%Y-%m-%d}.", "", *rows, *failed])
