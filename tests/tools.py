"""Programs that some tests need, which skip by name or fail where required; scripts of docs/."""

from __future__ import annotations

import html
import importlib
import os
import re
import shutil
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


TYPESET = re.compile(r"(?<!\\)\$.*?(?<!\\)\$")  # what Matplotlib shows as a formula
RAW = re.compile(r"\\|[_^]\{|\$[^$]*\$")  # what nobody should have to read


def raw_formulas(figure: Any, image: bytes) -> list[str]:
    """Texts of a figure, and of its file as SVG, in which a reader sees LaTeX.

    A dollar alone may come from a user's words.
    """
    from matplotlib.text import Text

    texts = [text.get_text() for text in figure.findobj(Text)]
    plain_texts = [TYPESET.sub("", text).replace(r"\$", "$") for text in texts]
    svg_texts = [html.unescape(text) for text in re.findall(r">([^<>]+)<", image.decode())]
    svg_texts += re.findall(r"<!--.*?-->", image.decode(), re.DOTALL)
    outside_of_style = [text for text in svg_texts if not text.startswith("*{")]
    return [text for text in (*plain_texts, *outside_of_style) if RAW.search(text)]


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
