"""Shared by all tests: hypothesis without deadlines, kept kernels, any order that a seed says."""

from __future__ import annotations

import contextlib
import functools
import gc
import hashlib
import os
import pickle
import random
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling

# As the command line does, and before NumPy is imported: matrices here are small.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import undeadzone
from cpu_times import SLOW, CpuTimes, function_of
from documents import raw_formulas
from requirements import pytest_sessionstart as pytest_sessionstart
from requirements import pytest_terminal_summary as pytest_terminal_summary
from undeadzone.report import style
from undeadzone.report.style import import_default_matplotlib
from undeadzone.util import files
from undeadzone_export import boards, compiler
from undeadzone_studies.ensemble import journal

gc.set_threshold(100_000)  # as the command line does
settings.register_profile(
    "shared",
    max_examples=30,  # `python -m tools.fuzz` and `make mutants` look longer
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=True,
)
settings.load_profile("shared")

# Compiled code of earlier runs, by its source: kernels, and programs of C.
CACHE = Path(os.environ.get("UNDEADZONE_TEST_CACHE", ".pytest_cache"))
UNUSED = 30 * 86400  # [s] after which it is deleted

# Files that share what `once.py` makes: one process has them.
TOGETHER = {
    "test_design": "design",
    "test_gain_search": "design",
    "test_report": "design",
    "test_json": "paper",
    "test_site": "paper",
    "test_tutorials": "paper",
    "test_audit": "paper",
    "test_arm": "paper",
    "test_both_sides": "paper",
    "test_figures": "paper",
    "test_manipulator": "paper",
    "test_recomputed": "paper",
    "test_theorem": "paper",
    "test_trials": "paper",
    "test_budget": "source",
    "test_language": "source",
    "test_layers": "source",
    "test_reading": "source",
}

# What takes longest, dealt first, so that all processes end at about the same time.
LONGEST = ("design", "test_docs", "test_exporting", "test_to_scenario", "test_names_of_logs",
           "test_odds", "test_alternatives",
           "paper", "test_kernel", "test_plc", "test_contact", "test_tune", "test_consistency",
           "test_notebook", "test_pipeline", "test_servo")  # fmt: skip


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--order", type=int, metavar="SEED", help="files, and tests within them, in random order"
    )
    parser.addoption(
        "--write-times",
        action="store_true",
        help="write tests/slow.txt and tests/cpu.toml from the CPU times of this run",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Keep compiled kernels between runs of the tests, while the compiler is the same.

    Programs of C (`compiled_once`) are kept while any run uses them. Bytecode is kept as well, so
    that the processes that tests start compile nothing twice.
    """
    config.pluginmanager.register(CpuTimes(config), "cpu times")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    digest = hashlib.sha256()
    for path in sorted((Path(undeadzone.__file__).parent / "compile").glob("*.py")):
        digest.update(path.read_bytes())
    folder = config.rootpath / CACHE
    own = folder / "kernels" / digest.hexdigest()[:16]
    own.mkdir(parents=True, exist_ok=True)
    os.utime(own)
    for path in (*folder.glob("kernels/*"), *folder.glob("compiled/*")):
        with contextlib.suppress(FileNotFoundError):  # another process was here
            if time.time() - path.stat().st_mtime > UNUSED:
                shutil.rmtree(path) if path.is_dir() else path.unlink()
    os.environ["UNDEADZONE_CACHE"] = str(own)


@pytest.fixture(autouse=True, scope="session")
def figures_are_read() -> Iterator[None]:
    """Each figure that a test writes, with whatever command, is read as its reader would.

    Tests of hostile titles are left out: those hold such characters themselves.
    """
    drawn = style.figure_to_bytes

    def read(figure: Any, kind: str) -> bytes:
        image = drawn(figure, kind)
        if "/security/" not in os.environ.get("PYTEST_CURRENT_TEST", ""):
            assert not raw_formulas(figure, image if kind == "svg" else b"")
        return image

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "figure_to_bytes", read)
        yield


@pytest.fixture(autouse=True, scope="session")
def code_of_no_effort(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """What an export compiles to look at its bits is not optimised: that takes ten times as long.

    `test_exporting.py` and `test_emulator.py` show that effort changes no bit. Nor is it compiled
    for boards, whose flash is estimated then.
    """
    script = tmp_path_factory.mktemp("compiler") / "cc"
    script.write_text('#!/bin/sh\nexec gcc "$@" -O0\n')
    script.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        if shutil.which("gcc"):
            patch.setenv("CC", str(script))
        patch.setattr(boards, "object_bytes", lambda command, files: None)
        yield script


@pytest.fixture(autouse=True, scope="session")
def compiled_once(pytestconfig: pytest.Config, code_of_no_effort: Path) -> Iterator[None]:
    """The same C is compiled once by the same gcc, also for the next run of the tests.

    A copy of what was made then, programs, libraries and accounts of the stack, stands in the new
    folder. Other compilers are called, as are all with files of other folders.
    """
    place = pytestconfig.rootpath / CACHE / "compiled"
    place.mkdir(parents=True, exist_ok=True)
    compile_, of_no_effort = compiler._run_compiler, str(code_of_no_effort)

    @functools.cache
    def bits(command: str) -> bytes:
        found = shutil.which(command)
        return hashlib.sha256(Path(found).read_bytes()).digest() if found else b""

    def called(line: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
        words = [word.replace(f"{folder.absolute()}{os.sep}", "") for word in line]
        elsewhere = any(os.sep in word or word == "-march=native" for word in words[1:])
        if words[0] not in ("cc", "gcc", of_no_effort) or elsewhere:
            return compile_(line, folder)
        codes = sorted(path for path in folder.iterdir() if path.suffix in (".c", ".h"))
        texts = [(one.name, one.read_bytes()) for one in codes]
        key = bits("gcc"), bits(words[0]), words[1:], os.environ.get("PATH"), texts
        stored = place / hashlib.sha256(repr(key).encode()).hexdigest()[:32]
        if not stored.exists():
            before = {(path, path.stat().st_mtime_ns) for path in folder.iterdir()}
            done = compile_(line, folder)
            after = {(path, path.stat().st_mtime_ns) for path in folder.iterdir()}
            written = {path.name: path.read_bytes() for path, _ in after - before}
            if done.returncode == 0:
                with files.replace_file(stored) as new:
                    new.write_bytes(pickle.dumps((done, written)))
            return done
        os.utime(stored)
        done, written = pickle.loads(stored.read_bytes())
        for name, content in written.items():
            (folder / name).write_bytes(content)
            (folder / name).chmod(0o755)
        return cast(subprocess.CompletedProcess[str], done)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiler, "_run_compiler", called)
        yield


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A file of tests has compiled kernels of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNDEADZONE_CACHE", str(tmp_path_factory.mktemp("kernels")))
        yield


@pytest.fixture(autouse=True, scope="session")
def formulas_read_once() -> Iterator[None]:
    """Each formula of a figure is set once: Matplotlib's renderers, three a figure, set their own.

    What is set depends on nothing but words, font and resolution, so pictures keep their bytes.
    """
    import_default_matplotlib()
    from matplotlib import textpath
    from matplotlib.backends import backend_agg

    with pytest.MonkeyPatch.context() as patch:
        for module in (textpath, backend_agg):
            patch.setattr(module, "MathTextParser", functools.cache(module.MathTextParser))
        yield


def group_of(path: Path) -> str:
    """The group of a file of tests."""
    return TOGETHER.get(path.stem, path.stem)


class InFiles(LoadScopeScheduling):  # type: ignore[misc]
    """Gives the tests of a file, and of files that belong together, to one process.

    xdist's own groups (3.8) are lost on pytest 9.2, and said nothing.
    """

    def _split_scope(self, nodeid: str) -> str:
        """The group of a test."""
        return group_of(Path(nodeid.partition("::")[0]))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> InFiles:
    """How several processes share the tests, whatever --dist says."""
    config.option.loadscopereorder = False  # by the number of tests: the longest have few
    return InFiles(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark slow tests. Put the longest first, or shuffle files and the tests of each."""
    slow = set(SLOW.read_text().split())
    for item in items:
        function = function_of(item.nodeid)
        if function in slow or function.partition("::")[0] in slow:
            item.add_marker(pytest.mark.slow)
    seed = config.getoption("order")
    if seed is None:
        place = {name: k for k, name in enumerate(LONGEST)}
        items.sort(key=lambda item: place.get(group_of(item.path), len(place)))
        return
    draw = random.Random(seed)
    files: dict[Path, list[pytest.Item]] = {}
    for item in items:
        files.setdefault(item.path, []).append(item)
    order = list(files.values())
    draw.shuffle(order)
    items.clear()
    for tests in order:
        draw.shuffle(tests)
        items.extend(tests)


@pytest.fixture
def closed_stores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Files of ensembles that a test opens and leaves, as a process does that is killed."""
    opened: list[journal.Store] = []
    start = journal.open_store

    def open_recorded(*arguments: Any, **more: Any) -> journal.Store:
        opened.append(start(*arguments, **more))
        return opened[-1]

    monkeypatch.setattr(journal, "open_store", open_recorded)
    yield
    for store in opened:
        store.close()
