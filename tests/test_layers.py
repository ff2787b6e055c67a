"""Imports point down, no files stand in a circle, catalogues hold methods only."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType

import pytest

import once
import undeadzone
import undeadzone_arena
import undeadzone_paper

ROOT = Path(undeadzone.__file__).parent
EXAMPLES = ROOT / "examples"  # stand there in a wheel, and are no room
FILES = sorted(
    path.relative_to(ROOT) for path in ROOT.rglob("*.py") if EXAMPLES not in path.parents
)
# The other packages of the distribution, and what of it each may import.
OTHERS = {undeadzone_paper: ("undeadzone",), undeadzone_arena: ("undeadzone", "undeadzone_paper")}

# From the ground up; rooms of one floor do not know each other.
FLOORS = (
    ("errors",),
    ("support",),
    ("compile", "ends", "linear", "logs", "numerics", "statistics"),
    ("plants", "signals"),
    ("feedforward",),
    ("analysis", "interfaces"),
    ("catalogue",),
    ("compensators", "controllers", "observers"),
    ("scenario",),
    ("results",),
    ("simulation",),
    ("ensemble", "exports", "identification", "synthesis"),
    ("tuning",),
    ("report",),
    ("cli",),
)
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}


def room(path: Path) -> str:
    """The room of a file; a file of the root is a room of its own."""
    return path.with_suffix("").parts[0]


def module(path: Path) -> str:
    """The name of a file's module below the package."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module(path) for path in FILES}


def imports(text: str) -> set[str]:
    """The modules of the package that a text imports, inside functions and for types too."""
    found = set()
    for node in once.nodes(text):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert not node.level, "relative imports hide where an arrow points"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(
                    inner if inner.removeprefix("undeadzone.") in MODULES else f"{node.module}"
                )
    return {name.removeprefix("undeadzone.") for name in found if name.startswith("undeadzone.")}


def upward(path: Path, text: str) -> list[str]:
    """The imports of a file that do not point to a lower floor."""
    here = room(path)
    outside = {
        name for name in imports(text) if name.split(".")[0] != here and name.split(".")[0] in FLOOR
    }
    return sorted(name for name in outside if FLOOR[name.split(".")[0]] >= FLOOR[here])


def circle(arrows: dict[str, set[str]]) -> set[str]:
    """What stands in a circle or points into one: nothing is left if there is none."""
    left = {name: set(targets) for name, targets in arrows.items()}
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    return set(left)


ROOMS = {room(path) for path in FILES} - {"__init__", "__main__"}


def test_every_room_has_its_floor() -> None:
    assert sorted(ROOMS) == sorted(FLOOR)


def test_imports_point_down() -> None:
    found = {}
    for path in FILES:
        if room(path) in FLOOR:
            found[str(path)] = upward(path, (ROOT / path).read_text(encoding="utf-8"))
    assert not {path: names for path, names in found.items() if names}


@pytest.mark.parametrize(
    "planted",
    [
        "from undeadzone.cli.run import run",
        "def late():\n    from undeadzone.report.style import write\n",
        "def late():\n    import undeadzone.results.run\n",
        "from undeadzone import cli\n",
        "if TYPE_CHECKING:\n    from undeadzone.controllers.pd import PD\n",
    ],
)
def test_an_upward_import_is_found(planted: str) -> None:
    assert upward(Path("observers/certified.py"), planted)


def test_no_files_stand_in_a_circle() -> None:
    arrows = {}
    for path in FILES:
        used = imports((ROOT / path).read_text(encoding="utf-8")) & MODULES
        arrows[module(path)] = used - {module(path)}
    assert not circle(arrows)


def test_a_circle_is_found() -> None:
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == {"a", "b", "c", "d"}
    assert not circle({"a": {"b"}, "b": set()})


@pytest.mark.parametrize("room", ["observers", "controllers", "compensators"])
def test_the_rooms_of_methods_hold_methods_alone(room: str) -> None:
    files = {path.stem for path in (ROOT / room).glob("*.py")} - {"__init__"}
    for name in sorted(files):
        text = (ROOT / room / f"{name}.py").read_text(encoding="utf-8")
        assert "tag=" in text, f"{room}/{name}.py is no method"


def packages(text: str) -> set[str]:
    """The packages of the distribution that a text imports."""
    found = set()
    for node in once.nodes(text):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return {name for name in found if name.startswith("undeadzone")}


def test_the_tool_knows_no_other_package() -> None:
    found = {path: packages((ROOT / path).read_text(encoding="utf-8")) for path in FILES}
    assert not {path: names for path, names in found.items() if names - {"undeadzone"}}


@pytest.mark.parametrize("package", OTHERS, ids=lambda package: package.__name__)
def test_other_packages_stand_on_the_tool(package: ModuleType) -> None:
    folder = Path(str(package.__file__)).parent
    allowed = {package.__name__, *OTHERS[package]}
    found = {path: packages(path.read_text(encoding="utf-8")) for path in folder.rglob("*.py")}
    assert len(found) > 10
    assert not {path: names for path, names in found.items() if names - allowed}


def test_a_foreign_import_is_found() -> None:
    assert packages("def late():\n    from undeadzone_arena import EKF\n") == {"undeadzone_arena"}
