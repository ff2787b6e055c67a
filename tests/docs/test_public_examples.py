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


def documented(public: object) -> list[str]:
    """Return the docstrings of a class or function and of its own public methods."""
    methods = [value for name, value in vars(public).items() if not name.startswith("_")]
    functions = [value for value in methods if inspect.isfunction(value)]
    return [inspect.getdoc(one) or "" for one in (public, *functions)]


def test_examples_of_public_names_run(tmp_path: Path) -> None:
    names = {"uz": uz, "msgspec": msgspec, "folder": tmp_path}
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner(verbose=False)
    reports: list[str] = []
    ran = 0
    for name in public_names():
        for text in documented(getattr(uz, name)):
            test = parser.get_doctest(text, names, name, None, None)
            test.globs = names
            runner.run(test, out=reports.append, clear_globs=False)
            ran += bool(test.examples)
    assert not reports, "\n".join(reports)
    assert ran > 40


def test_public_names_have_an_example_and_see_also() -> None:
    texts = {name: inspect.getdoc(getattr(uz, name)) or "" for name in public_names()}
    assert [name for name, text in texts.items() if "See Also:" not in text] == []
    assert [name for name, text in texts.items() if ">>>" not in text] == []
