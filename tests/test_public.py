"""The public names: each one in the stub can be imported and is documented, and importing the package loads nothing heavy."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import undeadzone

STUB = ast.parse(Path(undeadzone.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
NAMES = [
    alias.asname or alias.name
    for node in STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
]
HEAVY = ("numpy", "scipy", "casadi", "numba", "matplotlib", "clarabel", "msgspec", "rich", "cmaes")


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    found = getattr(undeadzone, name)
    own = found.__dict__.get("__doc__") if isinstance(found, type) else found.__doc__
    assert own
    assert own.strip()


def test_what_dir_shows_is_the_stub() -> None:
    assert sorted(undeadzone.__all__) == sorted(NAMES)
    assert set(NAMES) <= set(dir(undeadzone))


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import undeadzone", HEAVY),
        ("import undeadzone.cli", HEAVY),
        (
            "import undeadzone; undeadzone.Scenario, undeadzone.simulate, undeadzone.Online",
            ("scipy", "numba", "matplotlib", "clarabel", "rich", "cmaes"),
        ),
    ],
)
def test_imports_load_nothing_that_they_do_not_need(code: str, absent: tuple[str, ...]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert not set(done.stdout.split()) & set(absent)
