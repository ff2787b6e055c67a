"""Programs that some tests need, which skip by name or fail where required; scripts of docs/."""

from __future__ import annotations

import html
import os
import re
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
