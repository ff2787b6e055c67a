"""Each path says what is done with it; one function opens all that are read."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import types
import typing
from collections.abc import Iterator
from pathlib import Path

import click
import msgspec
import pytest

from documents import ROOT
from undeadzone.cli import group
from undeadzone.cli.common import UserPath
from undeadzone.registry import CONTROLLERS, OBSERVERS
from undeadzone.scenario.reader import FILE_KEYS
from undeadzone.scenario.schema import Scenario
from undeadzone.util.opening import Bound, _open_beneath

SRC = ROOT / "src"
OWN = (
    "undeadzone",
    "undeadzone_arena",
    "undeadzone_design",
    "undeadzone_export",
    "undeadzone_identify",
    "undeadzone_studies",
)
PAGE = ROOT / "docs" / "security.md"
LIKE_PATHS = ("DIR", "FILE", "LOG", "PATH", ".toml", ".urdf", ".csv")


def parameters() -> Iterator[tuple[str, click.Parameter]]:
    """Every parameter of every command, with the name of the command."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        for parameter in command.params:
            yield name, parameter


def title(parameter: click.Parameter) -> str:
    """What the page calls a parameter."""
    if isinstance(parameter, click.Option):
        return parameter.opts[0]
    assert parameter.metavar is not None
    return parameter.metavar.strip("[]").split()[0]


def test_each_path_of_each_command_says_what_is_done_with_it() -> None:
    bare = []
    for command, parameter in parameters():
        like = any(word in (parameter.metavar or "") for word in LIKE_PATHS)
        is_path = isinstance(parameter.type, click.Path | click.File)
        if (like or is_path) and not isinstance(parameter.type, UserPath):
            bare.append(f"{command} {parameter.name}")
    assert not bare


def test_the_page_has_the_table() -> None:
    there = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip(" `") for cell in line.strip("|").split("|")]
        if len(cells) == 4 and cells[3] == "you":
            there |= {(cells[0], command): cells[2] for command in cells[1].split(", ")}
    here = {
        (title(parameter), command): parameter.type.use
        for command, parameter in parameters()
        if isinstance(parameter.type, UserPath)
    }
    assert there == here


def structs(kind: object) -> Iterator[type[msgspec.Struct]]:
    """The structs that a type may hold."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield kind
        for each in typing.get_type_hints(kind).values():
            yield from structs(each)
    elif isinstance(kind, types.UnionType) or typing.get_origin(kind) is not None:
        for each in typing.get_args(kind):
            yield from structs(each)


def test_each_key_that_names_a_file_is_confined() -> None:
    """A key that is text and whose name tells of a file is among those that `confine` looks at."""
    every = {*structs(Scenario), *OBSERVERS.list_options(), *CONTROLLERS.list_options()}
    keys = {
        field.name
        for struct in every
        for field in msgspec.structs.fields(struct)
        if any(word in field.name for word in ("path", "file", "folder", "design"))
        and str in (field.type, *typing.get_args(typing.get_type_hints(struct)[field.name]))
    } | {"path"}
    assert keys == set(FILE_KEYS)


# Who opens without `open_plain`, and how often: null devices, files that this program has just
# written, its own texts, and the cache, whose owner is looked at.
OPENERS = {
    "undeadzone/cli/ending.py": 2,
    "undeadzone/cli/init.py": 3,
    "undeadzone/compile/cache.py": 1,
    "undeadzone/compile/cache_folder.py": 7,
    "undeadzone/report/animation.py": 1,
    "undeadzone/report/html.py": 2,
    "undeadzone/results/files.py": 3,
    "undeadzone/scenario/urdf_start.py": 1,
    "undeadzone/simulation/saved_state.py": 1,
    "undeadzone/util/files.py": 2,
    "undeadzone/util/opening.py": 3,
    "undeadzone_export/compiler.py": 2,
    "undeadzone_export/fmu/package.py": 1,
    "undeadzone_export/template.py": 1,
    "undeadzone_identify/chain.py": 1,  # the snippet that it wrote itself
    "undeadzone_identify/command.py": 1,
    "undeadzone_identify/results/to_scenario.py": 1,
    "undeadzone_studies/ensemble/saved.py": 1,
}


def opened_paths(tree: ast.AST) -> int:
    """How many calls open a path."""
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    named = [call.id for call in calls if isinstance(call, ast.Name)]
    methods = [call.attr for call in calls if isinstance(call, ast.Attribute)]
    of_paths = sum(methods.count(name) for name in ("open", "read_bytes", "read_text"))
    return named.count("open") + of_paths


def test_no_one_else_opens_a_users_file() -> None:
    found = {}
    for package in OWN:
        for path in sorted((SRC / package).rglob("*.py")):
            count = opened_paths(ast.parse(path.read_text(encoding="utf-8")))
            if count:
                found[path.relative_to(SRC).as_posix()] = count
    assert found == OPENERS


linux = pytest.mark.skipif(sys.platform != "linux", reason="openat2 is a call of Linux")


@linux
@pytest.mark.parametrize("kind", ["last", "folder"])
def test_a_link_that_is_put_there_after_the_look_leads_nowhere(tmp_path: Path, kind: str) -> None:
    """The path was looked at, then exchanged: the kernel refuses it."""
    folder, home = tmp_path / "up", tmp_path / "home"
    folder.mkdir()
    home.mkdir()
    (home / "secret.csv").write_text("tok3n")
    if kind == "last":
        (folder / "secret.csv").symlink_to(home / "secret.csv")
    else:
        (folder / "logs").symlink_to(home)
    relative = Path("secret.csv") if kind == "last" else Path("logs", "secret.csv")
    bound = Bound(folder, folder.resolve(), os.open(folder, os.O_PATH))
    with pytest.raises(OSError, match="symbolic links"):
        _open_beneath(bound, relative, os.O_RDONLY, 0)
    os.close(bound.descriptor or 0)


BOUND = """
import sys
from pathlib import Path
from undeadzone.util import opening
from undeadzone.util.files import read_bytes, write_text
if {old!r} == "old":
    opening.OPENAT2 = 10_000_000
opening.bind_folder(Path("up"))
for path in {paths!r}:
    try:
        print(read_bytes(path).decode())
    except OSError as error:
        print(error)
try:
    write_text("x", "up/out/x.txt")
except Exception as error:
    print(error)
"""


@pytest.mark.parametrize("old", ["new", "old"])
def test_what_is_bound_opens_nothing_that_leads_out(tmp_path: Path, old: str) -> None:
    """With the call of the kernel, and on one that does not have it."""
    (tmp_path / "up" / "in").mkdir(parents=True)
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "secret").write_text("tok3n")
    (tmp_path / "up" / "in" / "a").write_text("alpha")
    (tmp_path / "up" / "b").symlink_to("in/a")
    (tmp_path / "up" / "whole").symlink_to(tmp_path / "up" / "in" / "a")
    (tmp_path / "up" / "c").symlink_to("../home/secret")
    (tmp_path / "up" / "d").hardlink_to(tmp_path / "home" / "secret")
    (tmp_path / "up" / "out").symlink_to("../home")
    (tmp_path / "up" / "loop").symlink_to("loop")
    paths = ["up/in/a", "up/b", "up/whole", "up/c", "up/d", "up/loop", "up/../home/secret"]
    code = BOUND.format(old=old, paths=paths)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    a, b, whole, c, d, loop, outside, written = done.stdout.splitlines()
    assert (a, b, whole) == ("alpha", "alpha", "alpha")
    assert c == "a link that leads out of the untrusted folder up"
    assert "hard links" in d
    assert "symbolic links" in loop
    assert outside == "tok3n"  # the user named it, outside of the folder
    assert "a link that leads out of the untrusted folder up" in written
    assert [path.name for path in (tmp_path / "home").iterdir()] == ["secret"]


def test_a_name_that_is_too_long_or_a_file_is_refused_of_each_parameter(tmp_path: Path) -> None:
    """Whatever a command would do first with it."""
    for _, parameter in parameters():
        if isinstance(parameter.type, UserPath):
            refused = {"x" * 5000: "longer than this system allows"}
            refused |= dict.fromkeys(parameter.type.files, "is a file's name")
            for name, words in refused.items():
                with pytest.raises(click.BadParameter, match=words):
                    parameter.type.convert(name, parameter, None)
