"""Every public name has an example that runs, and says where to look next."""

from __future__ import annotations

import doctest
import inspect
from pathlib import Path
from types import ModuleType

import msgspec

import undeadzone as uz

# Examples build on each other, as a reader meets the names.
FIRST = ("Plant", "Sensor", "Sine", "Simulation", "Auto", "Certified", "Scenario", "simulate",
         "Online", "estimate", "run_ensemble")  # fmt: skip


def public_names() -> list[str]:
    """Return the public classes and functions, those that others build on first."""
    names = [name for name in dir(uz) if not name.startswith("_")]
    found = [name for name in names if not isinstance(getattr(uz, name), ModuleType)]
    return [*FIRST, *(name for name in found if name not in FIRST)]


def test_examples_of_public_names_run(tmp_path: Path) -> None:
    names = {"uz": uz, "msgspec": msgspec, "folder": tmp_path}
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner(verbose=False)
    reports: list[str] = []
    ran = 0
    for name in public_names():
        text = inspect.getdoc(getattr(uz, name)) or ""
        test = parser.get_doctest(text, names, name, None, None)
        test.globs = names
        runner.run(test, out=reports.append, clear_globs=False)
        ran += bool(test.examples)
    assert not reports, "\n".join(reports)
    assert ran > 40


def test_public_names_have_an_example_and_see_also() -> None:
    documented = {name: inspect.getdoc(getattr(uz, name)) or "" for name in public_names()}
    assert [name for name, text in documented.items() if "See Also:" not in text] == []
    # `identify` returns an `Identified`, and shows it.
    without = [name for name, text in documented.items() if ">>>" not in text]
    assert without == ["Identified"]
