"""A test whose program is missing skips by its name, or fails where that is required."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import once
from requirements import GROUPS, import_package, needs, require

TESTS = Path(__file__).parents[1]
SEARCHES = frozenset({"browser", "find_spec", "which"})  # functions that look for a program
REQUIRING = frozenset({"needs", "require"})
PLANTED = {
    "test_call.py": 'def test_call():\n    requirements.require("plc", ["iec2c"])\n',
    "test_mark.py": '@requirements.needs("compiler", "no-such-gcc")\ndef test_mark():\n    pass\n',
    "test_module.py": 'requirements.import_package("no_such")\n\n\ndef test_module():\n    pass\n',
}


def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UNDEADZONE_REQUIRE", raising=False)
    require("emulator", [])
    with pytest.raises(pytest.skip.Exception, match="emulator: not installed: qemu, gcc"):
        require("emulator", ["qemu", "gcc"])
    assert not needs("plc", "sh").args[0]
    assert needs("plc", "sh", "no-iec2c").kwargs == {"reason": "plc: not installed: no-iec2c"}
    with pytest.raises(pytest.skip.Exception, match="packages: not installed: no_such"):
        import_package("no_such")
    monkeypatch.setenv("UNDEADZONE_REQUIRE", "fmu,emulator,packages")
    with pytest.raises(pytest.fail.Exception, match="emulator: not installed: qemu"):
        require("emulator", ["qemu"])
    with pytest.raises(pytest.fail.Exception, match="emulator: not installed: no-qemu"):
        needs("emulator", "no-qemu")
    with pytest.raises(pytest.fail.Exception, match="packages: not installed: no_such"):
        import_package("no_such")
    with pytest.raises(pytest.skip.Exception):
        require("browser", ["chromium"])
    with pytest.raises(AssertionError, match="iec2c: no such group"):
        require("iec2c", [])


def run_planted(folder: Path, required: str) -> tuple[int, str]:
    """The exit code and the last line of pytest in a folder of tests whose programs are missing."""
    hook = "from requirements import pytest_sessionstart as pytest_sessionstart\n"
    (folder / "conftest.py").write_text(hook)
    for name, text in PLANTED.items():
        (folder / name).write_text(f"import requirements\n\n\n{text}")
    plain = ["-q", "-c", os.devnull, "--rootdir", ".", "-p", "no:cacheprovider", "-p", "no:xdist"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *plain, "--continue-on-collection-errors"],
        cwd=folder,
        env=os.environ | {"UNDEADZONE_REQUIRE": required, "PYTHONPATH": str(TESTS)},
        capture_output=True,
        text=True,
    )
    return done.returncode, (done.stdout + done.stderr).strip().splitlines()[-1]


@pytest.mark.parametrize(
    ("required", "code", "line"),
    [
        ("", 0, "3 skipped"),
        ("plc", 1, "1 failed, 2 skipped"),
        ("plc,compiler,packages", 1, "1 failed, 2 errors"),
        ("iec2c", 4, "UNDEADZONE_REQUIRE: iec2c: expected browser, compiler"),
    ],
)
def test_what_is_required_fails(tmp_path: Path, required: str, code: int, line: str) -> None:
    """A mark and the skip of a whole module too."""
    found = run_planted(tmp_path, required)
    assert found[0] == code
    assert line in found[1]


def called(node: ast.AST) -> set[str]:
    """The functions that are called below a node, by the last part of their names."""
    calls = [each for each in ast.walk(node) if isinstance(each, ast.Call)]
    return {ast.unparse(call.func).rpartition(".")[2] for call in calls}


def silent_skips(text: str) -> list[int]:
    """Lines that skip for want of a program or a package, and bypass `require`."""
    nodes = once.nodes(text)
    assigned = [node for node in nodes if isinstance(node, ast.Assign) and called(node) & SEARCHES]
    results = {ast.unparse(target) for node in assigned for target in node.targets}
    lines = set()
    for node in nodes:
        if isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            bypasses = name == "importorskip" or (name == "skipif" and searches(node, results))
        elif isinstance(node, ast.FunctionDef | ast.If):
            bypasses = "skip" in called(node) and searches(node, results)
        else:
            continue
        if bypasses:
            lines.add(node.lineno)
    return sorted(lines)


def searches(node: ast.AST, results: set[str]) -> bool:
    """Whether a node looks for a program, or uses the result of such a search."""
    names = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
    return bool(called(node) & SEARCHES or names & results)


@pytest.mark.parametrize(
    "planted",
    [
        'control = pytest.importorskip("control")\n',
        'pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")\n',
        'GCC = which("gcc")\n\n\n@pytest.mark.skipif(not GCC, reason="no gcc")\ndef test(): ...\n',
        'def test():\n    found = which("gcc")\n    if found is None:\n        pytest.skip("no")\n',
        'if not find_spec("fmpy"):\n    pytest.skip("no fmpy", allow_module_level=True)\n',
    ],
)
def test_a_silent_skip_is_found(planted: str) -> None:
    assert silent_skips(planted)


def test_every_skip_for_want_of_a_program_can_fail() -> None:
    allowed = (
        'require("plc", [] if which("iec2c") else ["iec2c"])\nif linux:\n    pytest.skip("no")'
    )
    assert not silent_skips(allowed)
    paths = [path for path in sorted(TESTS.rglob("*.py")) if path != Path(__file__)]
    texts = {str(path.relative_to(TESTS)): path.read_text(encoding="utf-8") for path in paths}
    found = {name: silent_skips(text) for name, text in texts.items() if "skip" in text}
    assert not {name: lines for name, lines in found.items() if lines}
    calls = [node for text in texts.values() for node in once.nodes(text) if called_here(node)]
    used = {call.args[0].value for call in calls if isinstance(call.args[0], ast.Constant)}
    assert used == GROUPS


def called_here(node: ast.AST) -> bool:
    """Whether a node calls `require` or `needs`."""
    return isinstance(node, ast.Call) and ast.unparse(node.func) in REQUIRING


def test_the_gate_requires_groups_that_exist() -> None:
    """Groups that no package registry and no extra can install are left out."""
    script = (TESTS.parent / ".ci" / "run").read_text(encoding="utf-8")
    (line,) = [line for line in script.splitlines() if "UNDEADZONE_REQUIRE=" in line]
    required = set(line.partition("=")[2].split(","))
    assert required == GROUPS - {"docs", "plc"}
