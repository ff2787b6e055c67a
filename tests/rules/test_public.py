"""The public names: each can be imported and is documented, and none is forgotten.

Importing the package loads nothing heavy.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
import typing
from importlib.metadata import entry_points
from pathlib import Path

import msgspec
import pytest

import undeadzone
from undeadzone import PD, Luenberger, Plant, Sine, TwoLink, ZoneInverse
from undeadzone.registry import COMPENSATORS, CONTROLLERS, OBSERVERS
from undeadzone.scenario.schema import Scenario

STUB = ast.parse(Path(undeadzone.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
OWN = [
    alias.asname or alias.name
    for node in STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
]
REGISTERED = [node.targets[0].id for node in STUB.body if isinstance(node, ast.Assign)]  # type: ignore[attr-defined]
NAMES = [*OWN, *REGISTERED]
ROOMS = ("observers", "controllers", "compensators", "signals", "plants")
HOME = Path(__file__).parents[2]
SYSTEMS = {
    "macos-latest": "MacOS",
    "ubuntu-latest": "POSIX :: Linux",
    "windows-latest": "Microsoft :: Windows",
}
TRIED = re.compile(r'\{ system: (\S+), python: "(\S+)", tried: true \}')
HEAVY = (
    "numpy",
    "scipy",
    "casadi",
    "llvmlite",
    "matplotlib",
    "clarabel",
    "msgspec",
    "rich",
    "cmaes",
)


@pytest.mark.parametrize("name", NAMES)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    found = getattr(undeadzone, name)
    own = found.__dict__.get("__doc__") if isinstance(found, type) else found.__doc__
    assert own
    assert own.strip()


def test_what_dir_shows_suffices_for_a_first_hour() -> None:
    assert sorted(undeadzone.__all__) == sorted(OWN)
    names = [name for name in dir(undeadzone) if not name.startswith("_")]
    assert len(names) <= 50
    assert set(names) <= set(NAMES)
    inner = {name for room in ROOMS for name in dir(getattr(undeadzone, room))}
    methods = {kind.__name__ for kind in (Sine, Plant, TwoLink, Luenberger, PD, ZoneInverse)}
    assert methods <= inner


def test_what_the_other_packages_register_is_in_the_stub() -> None:
    points = entry_points(group="undeadzone.names")
    assert sorted(point.name for point in points) == sorted(REGISTERED)
    assert all(point.load() is getattr(undeadzone, point.name) for point in points)


def structs(annotation: typing.Any) -> set[type[msgspec.Struct]]:
    """The structs that an annotation allows, those of their own fields included."""
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return {annotation}.union(
            *[structs(field.type) for field in msgspec.structs.fields(annotation)]
        )
    return set().union(*[structs(part) for part in typing.get_args(annotation)])


def hidden(kinds: typing.Iterable[type]) -> list[str]:
    """The names of those that a user cannot reach."""
    found = [kind for kind in kinds if getattr(undeadzone, kind.__name__, None) is not kind]
    return sorted(kind.__name__ for kind in found)


def test_every_part_of_a_scenario_is_public() -> None:
    methods = [*OBSERVERS.list_options(), *CONTROLLERS.list_options(), *COMPENSATORS.list_options()]
    kinds = structs(Scenario).union(*map(structs, methods))
    assert len(kinds) > 60
    assert not hidden(kinds)


def test_a_part_that_was_forgotten_is_found() -> None:
    class Forgotten(msgspec.Struct):
        inner: list[Scenario] | None = None

    assert {Forgotten, Scenario} <= structs(dict[str, Forgotten | None])
    assert hidden({Forgotten, Scenario}) == ["Forgotten"]


def test_what_public_functions_return_is_public() -> None:
    returned = set()
    for name in NAMES:
        public = getattr(undeadzone, name)
        if not isinstance(public, type) and callable(public):
            returned |= set(re.findall(r"\w+", public.__annotations__["return"]))
    elsewhere = {"Any", "Path", "None", "Figure"}  # of Python and matplotlib
    classes = {name for name in returned if name[0].isupper()} - elsewhere
    assert {"Run", "Design", "Tuned"} <= classes
    assert classes <= set(NAMES)


def test_help_says_where_assumptions_are_explained() -> None:
    """`help(uz.Auto)` named a class whose own help has no assumptions."""
    for options in (undeadzone.Auto, undeadzone.Censored):
        assert "options are those of `Assumptions`" in (options.__doc__ or "")
    assert "right, left: ranges [lo, hi] of d_r and d_l" in (undeadzone.Assumptions.__doc__ or "")


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import undeadzone", HEAVY),
        ("import undeadzone.cli", HEAVY),
        (
            "import undeadzone; undeadzone.Scenario, undeadzone.simulate, undeadzone.Online",
            ("scipy", "llvmlite", "matplotlib", "clarabel", "rich", "cmaes"),
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


def test_classifiers_name_what_was_tried() -> None:
    """Rows of the matrix in .github/workflows/ci.yml that passed once; others may fail there."""
    workflow = (HOME / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    tried = TRIED.findall(workflow)
    project = tomllib.loads((HOME / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    classifiers = {
        name.removeprefix("Programming Language :: Python :: ").removeprefix("Operating System :: ")
        for name in project["classifiers"]
        if re.match(r"Operating System|Programming Language :: Python :: 3\.\d+$", name)
    }
    assert classifiers == {name for system, python in tried for name in (SYSTEMS[system], python)}
    assert ("ubuntu-latest", "3.11") in tried
