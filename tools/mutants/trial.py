"""One mutant in a process of its own, forked from one that has imported everything.

The functions of the package that runs get the code of the mutant's: so nothing is imported again.
"""

from __future__ import annotations

import ast
import functools
import importlib
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import types
from collections.abc import Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from tests.search_path import add_test_folders

DID_NOT_RUN: Final = 30  # exit code of a process whose tests did not begin
NO_IMPORT: Final = 31  # exit code where the changed file cannot be executed
PATIENCE: Final = 3.0  # times the usual cost, after which a mutant counts as noticed
CLOCK: Final = 600.0  # [s] after which a process that sleeps is ended


def preload(root: Path, tests: Collection[str]) -> None:
    """Import the package and files of tests, so that every mutant starts with them.

    Args:
        root: of the repository.
        tests: files, relative to it.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as conftest.py does, which comes later
    add_test_folders(root)
    sys.path[:0] = sorted({str((root / test).parent) for test in tests})  # as pytest does
    source = root / "src"
    for path in sorted(source.rglob("*.py")):
        if path.name not in ("__init__.py", "__main__.py") and "templates" not in path.parts:
            importlib.import_module(".".join(path.relative_to(source).with_suffix("").parts))
    for test in sorted(tests):
        with suppress(KeyError):  # it needs a variable that pytest sets, and imports it later
            importlib.import_module(Path(test).stem)


def noticed(file: str, tree: ast.Module, tests: Sequence[str], cost: float) -> tuple[bool, str]:
    """Whether tests notice a mutant, and how: the first test that fails, if one does.

    Args:
        file: that is changed, relative to the folder of all packages.
        tree: the file, changed.
        tests: to be run, by their ids.
        cost: of them, usually [s].

    Raises:
        RuntimeError: the tests did not run, which says nothing of the mutant.
    """
    failed = os.memfd_create("failed")
    pid = os.fork()
    if not pid:
        os._exit(_run(file, tree, tests, cost, failed))
    until = time.monotonic() + CLOCK
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() > until:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)
    os.lseek(failed, 0, os.SEEK_SET)
    first = os.read(failed, 10_000).decode().partition("\n")[0]
    os.close(failed)
    if os.WIFSIGNALED(status):
        return True, f"signal {os.WTERMSIG(status)}"
    code = os.WEXITSTATUS(status)
    if code in (4, 5, DID_NOT_RUN):  # 4 and 5: of pytest, for options or tests that are not there
        raise RuntimeError(f"{file}: exit {code} before the first test: {' '.join(tests)}")
    known = {0: "", 1: first, NO_IMPORT: "it cannot be imported"}
    return code != 0, known.get(code, f"code {code}")


def noticed_afresh(
    root: Path, file: str, tree: ast.Module, tests: Sequence[str], seconds: float
) -> tuple[bool, str]:
    """Whether tests notice a mutant that is imported in place of its file, by their processes too.

    Args:
        root: of the repository.
        file: that is changed, relative to the folder of all packages.
        tree: the file, changed.
        tests: files or ids of tests, in the order in which they are run.
        seconds: after which they are ended, which says nothing of the mutant.
    """
    with tempfile.TemporaryDirectory() as name:
        text = Path(name, "changed.py")
        text.write_text(ast.unparse(tree), encoding="utf-8")
        changed = {
            "MUTANT_MODULE": ".".join(Path(file).with_suffix("").parts),
            "MUTANT_TEXT": str(text),
            "PYTHONPATH": str(Path(__file__).with_name("afresh")),
        }
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
        with subprocess.Popen(
            [*command, *tests],
            cwd=root,
            env=os.environ | changed,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                said = process.communicate(timeout=seconds)[0]
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                return False, f"nothing within {seconds:g} s"
    if process.returncode not in (0, 1, 2):  # 2: a file of tests cannot be imported
        raise RuntimeError(f"{file}: exit {process.returncode}: {said[-1000:]}")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
    return process.returncode != 0, failed[1] if failed else ""


class _Failures:
    """A plug-in of pytest that writes down which tests fail.

    Args:
        into: the file's number.
    """

    def __init__(self, into: int) -> None:
        self.into = into

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            os.write(self.into, f"{report.nodeid}\n".encode())


def _run(file: str, tree: ast.Module, tests: Sequence[str], cost: float, failed: int) -> int:
    """Run the tests in this process; pytest's exit code."""
    try:
        import pytest

        limit = int(PATIENCE * cost + 15 + time.process_time())
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(null, number)
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:cov"]
        # Hypothesis is imported before pytest could rewrite its assertions.
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
        name = ".".join(Path(file).with_suffix("").parts)
        try:
            plant(sys.modules[name], tree)
        except Exception:
            return NO_IMPORT
        return int(pytest.main([*options, *tests], plugins=[_Failures(failed)]))
    except BaseException:
        return DID_NOT_RUN


def plant(module: Any, tree: ast.Module) -> None:
    """Give a module's functions, classes and constants what a changed tree says."""
    fresh = types.ModuleType(module.__name__)
    fresh.__file__, fresh.__package__ = module.__file__, module.__package__
    sys.modules[module.__name__] = fresh  # dataclasses and annotations look it up there
    try:
        exec(compile(tree, str(module.__file__), "exec"), fresh.__dict__)
    finally:
        sys.modules[module.__name__] = module
    for name, new in list(vars(fresh).items()):
        old = vars(module).get(name)
        if name.startswith("__") or old is None:
            continue
        if isinstance(new, type):
            if new.__module__ == module.__name__:
                _swap_class(old, new)
        elif not _swap(old, new):
            _rebind(name, old, new)


def _swap_class(old: Any, new: Any) -> None:
    """Give the methods of a class the code of another's."""
    for name, value in list(vars(new).items()):
        before = vars(old).get(name)
        if isinstance(value, property) and isinstance(before, property):
            _swap(before.fget, value.fget)
        elif before is not None:
            _swap(before, value)


def _swap(old: Any, new: Any) -> bool:
    """Give a function the code of another one; whether it is a function of its module."""
    while isinstance(new, (staticmethod, classmethod, functools.cached_property)):
        inner = "func" if isinstance(new, functools.cached_property) else "__func__"
        old, new = getattr(old, inner), getattr(new, inner)
    while hasattr(new, "__wrapped__"):
        old, new = old.__wrapped__, new.__wrapped__
    if not isinstance(new, types.FunctionType):
        return callable(new) or isinstance(new, types.ModuleType)
    if old.__code__.co_filename == new.__code__.co_filename:
        old.__code__ = new.__code__
        old.__defaults__, old.__kwdefaults__ = new.__defaults__, new.__kwdefaults__
    return True


def _rebind(name: str, old: Any, new: Any) -> None:
    """Put a constant in the place of another one, wherever it was imported."""
    for module in list(sys.modules.values()):
        own = getattr(module, "__dict__", {})
        if getattr(module, "__name__", "").startswith("undeadzone") and own.get(name) is old:
            own[name] = new
