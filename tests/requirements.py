"""Programs that some tests need, which skip by name or fail where required."""

from __future__ import annotations

import importlib
import os
import shutil
from collections import Counter
from typing import Any

import pytest

# What tests may need; UNDEADZONE_REQUIRE names those that must be there.
GROUPS = frozenset(["browser", "compiler", "docs", "emulator", "fmu", "git", "packages", "plc"])


def required_groups() -> set[str]:
    """The groups that UNDEADZONE_REQUIRE names."""
    return set(os.environ.get("UNDEADZONE_REQUIRE", "").split(",")) - {""}


def require(group: str, missing: list[str]) -> None:
    """Skip the test, or the module, that calls this, by the names of what is missing.

    Where UNDEADZONE_REQUIRE names the group it fails instead.
    """
    assert group in GROUPS, f"{group}: no such group"
    if not missing:
        return
    message = f"{group}: not installed: {', '.join(missing)}"
    if group in required_groups():
        pytest.fail(message)
    pytest.skip(message, allow_module_level=True)


def needs(group: str, *programs: str) -> pytest.MarkDecorator:
    """The mark of tests that need programs; the whole module fails where they are required."""
    reason = ""
    try:
        require(group, [name for name in programs if shutil.which(name) is None])
    except pytest.skip.Exception as skipped:
        reason = str(skipped)
    return pytest.mark.skipif(bool(reason), reason=reason)


def import_package(name: str) -> Any:
    """A module of a package that the extra `test` installs; `require` says if it is missing."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError:
        require("packages", [name])
        raise


def pytest_sessionstart() -> None:
    """Refuse names in UNDEADZONE_REQUIRE that no test knows."""
    unknown = required_groups() - GROUPS
    if unknown:
        known = ", ".join(sorted(GROUPS))
        raise pytest.UsageError(f"UNDEADZONE_REQUIRE: {', '.join(unknown)}: expected {known}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which tests were skipped for want of what, and how many: no skip is silent."""
    counts: Counter[str] = Counter()
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        counts[reason.removeprefix("Skipped: ")] += 1
    for reason, count in sorted(counts.items()):
        terminalreporter.write_line(f"skipped {count}: {reason}")
