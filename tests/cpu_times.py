"""CPU time of tests: which are slow, how much each file takes, and whether one takes too much.

    pytest -n 2 --write-times       write tests/slow.txt and tests/cpu.toml (`make times`)
    python tests/cpu_times.py       print the files that take most

Seconds are those of a machine on which the yardstick takes `UNIT`. It runs in each process before
and after the tests, so that a slower or busier machine changes no verdict.
"""

from __future__ import annotations

import resource
import statistics
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

SLOW = Path(__file__).with_name("slow.txt")  # functions, and whole files that share a slow start
LEAST_SLOW = 0.25  # CPU time of a slow test [s]: those below take two minutes together
TABLE = Path(__file__).with_name("cpu.toml")
UNIT = 0.1  # CPU time of the yardstick that defines a second [s]
EXCESS = 2.0  # times its ceiling that a file may take: compiled kernels may be missing
GRACE = 10.0  # [s] beyond that
HEAD = """\
# CPU seconds of each file of tests, written by `make times`. A file that takes more than twice its
# figure and 10 s fails the run. Empty lines let git merge branches that change different rows.
"""


def function_of(nodeid: str) -> str:
    """Return the file and the function of a test, without its parameters."""
    return nodeid.partition("[")[0]


def measure_cpu() -> float:
    """Return the CPU time of this process and of those that it has waited for [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def measure_yardstick() -> float:
    """Return the CPU time of a fixed amount of Python and NumPy [s]."""
    before = measure_cpu()
    matrix, total = np.eye(4) * 0.5, 0
    for index in range(30_000):
        total += index % 7
        matrix = matrix @ matrix + 0.1
        matrix /= matrix.max()
    return measure_cpu() - before


class CpuTimes:
    """Plugin of pytest that collects the CPU time of tests from all processes.

    Attributes:
        longest: CPU time of the longest case of each function, without its fixtures [s].
        files: CPU time of each file of tests, fixtures included [s].
        yardsticks: of the processes [s].
        writes: whether the tables are written at the end.
    """

    def __init__(self, config: pytest.Config) -> None:
        self.longest: dict[str, float] = {}
        self.files = Counter[str]()
        self.yardsticks: list[float] = []
        self.writes = bool(config.getoption("--write-times"))
        self.is_worker = hasattr(config, "workerinput")
        self.misses: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Note the CPU time of the fixtures of a test."""
        return (yield from note_cpu(item, "start"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Note the CPU time of a test, which reaches the process that writes reports."""
        return (yield from note_cpu(item, "cpu"))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Iterator[None]:
        """Note the CPU time of the end of the fixtures."""
        return (yield from note_cpu(item, "end"))

    def pytest_sessionstart(self) -> None:
        """Measure the machine before the tests."""
        self.yardsticks.append(measure_yardstick())

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the CPU time of a test to those of its function and file."""
        if report.when != "teardown":
            return
        spent = dict(report.user_properties)
        function = function_of(report.nodeid)
        self.longest[function] = max(self.longest.get(function, 0.0), float(spent.get("cpu", 0.0)))
        file = report.nodeid.partition("::")[0]
        self.files[file] += sum(float(spent.get(part, 0.0)) for part in ("start", "cpu", "end"))

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: object) -> None:
        """Take over the yardsticks of a process that ends."""
        self.yardsticks += getattr(node, "workeroutput", {}).get("yardsticks", [])

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Write the tables, or compare the files with their ceilings."""
        self.yardsticks.append(measure_yardstick())
        if self.is_worker:
            session.config.workeroutput["yardsticks"] = self.yardsticks  # type: ignore[attr-defined]
            return
        scale = UNIT / statistics.median(self.yardsticks)
        files = {name: scale * seconds for name, seconds in self.files.items()}
        if self.writes:
            write_slow(self.longest)
            write_files(files)
            return
        self.misses = find_misses(files, read_files())
        if self.misses and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the CPU time of all tests, and the files that take too much."""
        terminalreporter.write_line(f"CPU time of the tests: {self.files.total():.0f} s")
        for line in self.misses:
            terminalreporter.write_line(f"FAILED {line}", red=True)


def note_cpu(item: pytest.Item, part: str) -> Iterator[None]:
    """Add the CPU time of a part of a test to its report [s]."""
    before = measure_cpu()
    try:
        return (yield)
    finally:
        item.user_properties.append((part, measure_cpu() - before))


def write_slow(longest: dict[str, float]) -> None:
    """Write the list of slow tests; tests that did not run keep their line."""
    known = {name for name in SLOW.read_text().split() if name not in longest}
    slow = known | {name for name, seconds in longest.items() if seconds >= LEAST_SLOW}
    files = {name for name in known if "::" not in name}
    slow = {name for name in slow if name in files or name.partition("::")[0] not in files}
    SLOW.write_text("".join(f"{name}\n" for name in sorted(slow)))


def read_files() -> dict[str, float]:
    """Read the CPU time of each file of tests [s]."""
    return tomllib.loads(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else {}


def write_files(files: dict[str, float]) -> None:
    """Write the CPU time of each file of tests, without the files that are gone."""
    every = {name: seconds for name, seconds in read_files().items() if Path(name).exists()}
    every |= {name: round(seconds, 1) for name, seconds in files.items()}
    rows = [f'"{name}" = {seconds}\n' for name, seconds in sorted(every.items())]
    TABLE.write_text("\n".join([HEAD, *rows]), encoding="utf-8")


def find_misses(files: dict[str, float], ceilings: dict[str, float]) -> list[str]:
    """Return a line for each file that takes too much CPU time.

    Args:
        files: CPU time of the files that ran [s]. Some of their tests may be left out.
        ceilings: of the files [s].
    """
    lines = []
    for name, seconds in sorted(files.items()):
        allowed = EXCESS * ceilings.get(name, 0.0) + GRACE
        if seconds > allowed:
            lines.append(f"{name}: {seconds:.1f} CPU s, {allowed:.1f} allowed. Move tests to"
                         " `make long`, or share what they compute (CONTRIBUTING.md)")  # fmt: skip
    return lines


def main() -> None:
    """Print the total and the twenty files that take most."""
    files = Counter(read_files())
    sys.stdout.write(f"{files.total():8.1f}  total\n")
    for name, seconds in files.most_common(20):
        sys.stdout.write(f"{seconds:8.1f}  {name}\n")


if __name__ == "__main__":
    main()
