"""One mutant in a process of its own, forked from one that has the libraries already."""

from __future__ import annotations

import ast
import importlib.abc
import importlib.machinery
import importlib.util
import os
import resource
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

PATIENCE: Final = 3.0  # times the usual cost, after which a mutant counts as noticed
CLOCK: Final = 600.0  # [s] after which a process that sleeps is ended


class Planted(importlib.abc.MetaPathFinder):
    """Finds one module: the mutant."""

    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        self._name, self._path, self._tree = name, path, tree

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> Any:
        """The mutant's spec."""
        if fullname != self._name:
            return None
        tree = self._tree

        class Loader(importlib.machinery.SourceFileLoader):
            def get_code(self, fullname: str) -> Any:
                return compile(tree, self.path, "exec")

        loader = Loader(fullname, str(self._path))
        return importlib.util.spec_from_loader(fullname, loader, origin=str(self._path))


def noticed(
    package: Path, file: str, tree: ast.Module, tests: Sequence[str], cost: float
) -> tuple[bool, str]:
    """Whether tests notice a mutant, and how.

    Args:
        package: the package's folder.
        file: that is changed, relative to it.
        tree: the file, changed.
        tests: to be run, by their ids.
        cost: of them, usually [s].
    """
    pid = os.fork()
    if not pid:
        os._exit(_run(package, file, tree, tests, cost))
    until = time.monotonic() + CLOCK
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            break
        if time.monotonic() > until:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.02)
    if os.WIFSIGNALED(status):
        return True, f"signal {os.WTERMSIG(status)}"
    code = os.WEXITSTATUS(status)
    return code != 0, {0: "", 1: "a test"}.get(code, f"pytest's code {code}")


def _run(package: Path, file: str, tree: ast.Module, tests: Sequence[str], cost: float) -> int:
    """Run the tests in this process; pytest's exit code."""
    try:
        import pytest

        limit = int(PATIENCE * cost + 15)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))
        null = os.open(os.devnull, os.O_RDWR)
        for number in (0, 1, 2):
            os.dup2(null, number)
        name = ".".join([package.name, *Path(file).with_suffix("").parts])
        sys.meta_path.insert(0, Planted(name, package / file, tree))
        options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-p", "no:cov"]
        return int(pytest.main([*options, *tests]))
    except BaseException:
        return 3
