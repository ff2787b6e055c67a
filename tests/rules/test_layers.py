"""Imports point down, no files stand in a circle, catalogues hold methods only."""

from __future__ import annotations

import ast
import functools
import importlib
import re
import tomllib
from importlib.util import resolve_name
from pathlib import Path
from types import ModuleType

import pytest

import once
import undeadzone
import undeadzone_design
import undeadzone_studies

ROOT = Path(undeadzone.__file__).parent
LAYERS = tomllib.loads(Path(__file__).with_name("layers.toml").read_text("utf-8"))
PACKAGES = list(map(importlib.import_module, LAYERS))
# Calls that import a module by its name, and calls that attach the names of the stub beside a file.
IMPORTING = frozenset({"__import__", "import_module", "load"})
ATTACHING = frozenset({"attach_package", "attach_stub"})
# Files that import what a table or an installed package names.
BY_TABLE = {"report/plot.py", "util/installed.py"}
# Files that a second distribution contains too, under another name of the package.
SHARED = {"numerics/deadzone_update.py"}
each_package = pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)


@functools.cache
def texts(package: ModuleType) -> dict[Path, str]:
    """The files of a package, by their path in it; examples stand in a wheel, and are no room."""
    root = Path(str(package.__file__)).parent
    paths = sorted(path.relative_to(root) for path in root.rglob("*.py"))
    return {
        path: (root / path).read_text(encoding="utf-8")
        for path in paths
        if path.parts[0] != "examples"
    }


def room(path: Path) -> str:
    """The room of a file; a file of the root is a room of its own."""
    return path.with_suffix("").parts[0]


def module(path: Path) -> str:
    """The name of a file's module below the package."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def call_name(node: ast.AST) -> str:
    """The last part of the name of a called function; empty for any other node."""
    return ast.unparse(node.func).rpartition(".")[2] if isinstance(node, ast.Call) else ""


def literal_head(node: ast.AST | None) -> str:
    """The module that a text names, or the package that a format begins with; empty if unknown."""
    if isinstance(node, ast.JoinedStr):
        begin = literal_head(node.values[0])
        return begin.rpartition(".")[0] or begin
    return str(node.value) if isinstance(node, ast.Constant) and node.value else ""


def imported_by(call: ast.Call, place: str) -> str:
    """The module that a call of `IMPORTING` names, in a file of the package `place`."""
    keywords = {each.arg: each.value for each in call.keywords}
    name, anchor, *_ = [*call.args, None, None]
    module = literal_head(name or keywords.get("name"))
    package = literal_head(anchor or keywords.get("package")) or place
    return resolve_name(module, package) if module else ""


def attached_by(call: ast.Call, place: str) -> set[str]:
    """The modules of a package that `lazy_loader.attach` lists."""
    tables = [*call.args[1:], *(each.value for each in call.keywords)]
    entries = [
        entry for table in tables for entry in getattr(table, "keys", getattr(table, "elts", []))
    ]
    return {f"{place}.{literal_head(entry)}" for entry in entries}


def modules_of_stub(stub: str, place: str) -> set[str]:
    """The modules of a stub that `lazy_loader` attaches: those of its relative imports."""
    relative = [node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom)]
    return {
        f"{place}.{node.module or alias.name}"
        for node in relative
        for alias in node.names
        if node.level == 1
    }


def late_imports(text: str, place: str, stub: str = "") -> set[str]:
    """The modules that the calls in a text import.

    Args:
        text: of a file.
        place: package of the file.
        stub: beside it.
    """
    found = set()
    for node in once.nodes(text):
        name = call_name(node)
        if name in IMPORTING:
            found.add(imported_by(node, place))
        elif name == "attach":
            found |= attached_by(node, place)
        elif name in ATTACHING:
            found |= modules_of_stub(stub, place)
    return found - {""}


def imports(text: str, package: ModuleType, path: Path = Path("a.py")) -> set[str]:
    """The modules of a package that a file imports, inside functions, by calls, for types too."""
    modules = {module(each) for each in texts(package)}
    here = f"{package.__name__}."
    stub = (Path(str(package.__file__)).parent / path).with_suffix(".pyi")
    place = ".".join([package.__name__, *path.parent.parts])
    found = late_imports(text, place, stub.read_text(encoding="utf-8") if stub.exists() else "")
    for node in once.nodes(text):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            relative = "relative imports hide where an arrow points"
            assert not node.level or path.as_posix() in SHARED, relative
            origin = resolve_name("." * node.level + (node.module or ""), place)
            for alias in node.names:
                inner = f"{origin}.{alias.name}"
                found.add(inner if inner.removeprefix(here) in modules else origin)
    return {name.removeprefix(here) for name in found if name.startswith(here)}


def upward(path: Path, text: str, package: ModuleType = undeadzone) -> list[str]:
    """The imports of a file that do not point to a lower floor of its package."""
    floor = {
        name: height
        for height, rooms in enumerate(LAYERS[package.__name__]["floors"])
        for name in rooms
    }
    here = room(path)
    rooms = {name: name.split(".")[0] for name in imports(text, package, path)}
    outside = {name: other for name, other in rooms.items() if other != here and other in floor}
    return sorted(name for name, other in outside.items() if floor[other] >= floor[here])


def circle(arrows: dict[str, set[str]]) -> set[str]:
    """What stands in a circle or points into one: nothing is left if there is none."""
    left = {name: set(targets) for name, targets in arrows.items()}
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    return set(left)


@each_package
def test_every_room_has_its_floor(package: ModuleType) -> None:
    rooms = {room(path) for path in texts(package)} - {"__init__", "__main__"}
    assert sorted(rooms) == sorted(
        name for floor in LAYERS[package.__name__]["floors"] for name in floor
    )


@each_package
def test_imports_point_down(package: ModuleType) -> None:
    found = {}
    for path, text in texts(package).items():
        if room(path) not in ("__init__", "__main__"):
            found[str(path)] = upward(path, text, package)
    assert not {path: names for path, names in found.items() if names}


@pytest.mark.parametrize(
    "planted",
    [
        "from undeadzone.cli.run import run",
        "def late():\n    from undeadzone.report.style import write\n",
        "def late():\n    import undeadzone.results.run\n",
        "from undeadzone import cli\n",
        "if TYPE_CHECKING:\n    from undeadzone.controllers.pd import PD\n",
        'import_module("undeadzone.cli.run")\n',
        'def late():\n    importlib.import_module("undeadzone.report.style").write()\n',
        'import_module(f"undeadzone.report.{kind}")\n',
        'import_module(name="..report.style", package="undeadzone.observers")\n',
        'import_module("..report.style", __package__)\n',
        '__import__("undeadzone.cli")\n',
        'late = lazy_loader.load("undeadzone.cli.run")\n',
    ],
)
def test_an_upward_import_is_found(planted: str) -> None:
    assert upward(Path("observers/certified.py"), planted)


def test_what_a_call_imports_is_found() -> None:
    place = "undeadzone.plants"
    attached = 'lazy.attach(__name__, ["options"], submod_attrs={"interop": ["to_control"]})'
    assert late_imports(attached, place) == {f"{place}.options", f"{place}.interop"}
    stub = "import undeadzone_design\nfrom . import build as build\nfrom .options import Plant\n"
    for attaching in ("lazy.attach_stub(__name__, __file__)", "attach_package(__name__, file)"):
        assert late_imports(attaching, place, stub) == {f"{place}.build", f"{place}.options"}
    assert "plants.interop" in imports(attaching, undeadzone, Path("plants/__init__.py"))
    assert not late_imports("import_module(module)\nload(path)\nattach()", place)


def unnamed_imports(text: str) -> list[int]:
    """Lines that import a module whose name no literal begins."""
    by_name = IMPORTING - {"load"}
    calls = [node for node in once.nodes(text) if call_name(node) in by_name]
    return [call.lineno for call in calls if not imported_by(call, "undeadzone")]


def test_a_module_without_a_literal_name_is_imported_from_tables_alone() -> None:
    """The other rules can not see it."""
    found = {
        str(path)
        for package in PACKAGES
        for path, text in texts(package).items()
        if unnamed_imports(text)
    }
    assert found == BY_TABLE
    assert unnamed_imports("import_module(INTEROP)\n__import__('undeadzone.' + name)") == [1, 2]


@each_package
def test_no_files_stand_in_a_circle(package: ModuleType) -> None:
    every = texts(package)
    modules = {module(path) for path in every}
    arrows = {}
    for path, text in every.items():
        arrows[module(path)] = (imports(text, package, path) & modules) - {module(path)}
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


def is_option(text: str) -> bool:
    """Whether a text of the code names an option of the command line, such as --columns."""
    return re.search(r"(?:^|[ (:])--[a-z]", text) is not None


def test_rooms_below_the_command_line_name_no_option() -> None:
    """They name arguments of functions; `cli.ending.name_options` makes options of them."""
    found = []
    below = [*texts(undeadzone).items(), *texts(undeadzone_design).items()]
    below += texts(undeadzone_studies).items()
    for path, text in below:
        if room(path) in ("cli", "commands", "report", "__main__"):  # pages show whole commands
            continue
        for node in once.nodes(text):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found += [f"{path}:{node.lineno}"] * is_option(node.value)
    assert found == []
    assert is_option("name them by --columns t=1")
    assert not is_option("margin -- a number")


def packages(text: str) -> set[str]:
    """The packages of the distribution that a text imports."""
    found = {name.split(".")[0] for name in late_imports(text, "here")}
    for node in once.nodes(text):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        if isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return {name for name in found if name.startswith("undeadzone")}


@each_package
def test_packages_stand_on_each_other_as_listed(package: ModuleType) -> None:
    """The tool knows none of the others."""
    allowed = {package.__name__, *LAYERS[package.__name__]["imports"]}
    found = {path: packages(text) for path, text in texts(package).items()}
    assert len(found) > 1
    assert not {path: names for path, names in found.items() if names - allowed}


def test_a_foreign_import_is_found() -> None:
    assert packages("def late():\n    from undeadzone_arena import EKF\n") == {"undeadzone_arena"}
    assert packages('import_module("undeadzone_arena.contest")') == {"undeadzone_arena"}
    assert packages('import_module(f"undeadzone_{name}.command")') == {"undeadzone_"}
