"""Programs that some tests need, which skip by name or fail where required; scripts of docs/."""

from __future__ import annotations

import os
from collections import Counter
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

DOCS = Path(__file__).parents[1] / "docs"


def script_of_docs(name: str) -> Any:
    """The module of a script in docs/, which is no package."""
    spec = spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def require(group: str, missing: list[str]) -> None:
    """Skip the test that calls this, by the names of what is missing.

    Where UNDEADZONE_REQUIRE names the group (emulator, fmu, browser, plc) it fails instead.
    """
    if not missing:
        return
    message = f"{group}: not installed: {', '.join(missing)}"
    if group in os.environ.get("UNDEADZONE_REQUIRE", "").split(","):
        pytest.fail(message)
    pytest.skip(message)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which tests were skipped for want of what, and how many: no skip is silent."""
    counts: Counter[str] = Counter()
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        counts[reason.removeprefix("Skipped: ")] += 1
    for reason, count in sorted(counts.items()):
        terminalreporter.write_line(f"skipped {count}: {reason}")
