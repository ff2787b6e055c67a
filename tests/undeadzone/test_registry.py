"""A method from another package: registered by entry points, or by a line in the catalogue."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

import undeadzone
from documents import ROOT
from undeadzone.registry import OBSERVERS

OWN = '''"""An observer whose widths stay where they are, and a command."""

import click
import numpy as np

from undeadzone.registry import Options
from undeadzone.interfaces import Observer
from undeadzone.observers.adaptive.gain import innovation_gain
from undeadzone.observers.adaptive.branch_observer import build_branch_observer
from undeadzone.observers.adaptive.adaptation_laws import read_initial_widths
from undeadzone.plants.system import System
from undeadzone.nonlinearities.sensor import Zone
from undeadzone.util.arrays import Array


class Held(Options, frozen=True, kw_only=True, tag="held"):
    """Widths held at their guess.

    Attributes:
        widths0: d_r and d_l.
    """

    widths0: Array = 0.0

    def build(self, model: System, sensor: Zone) -> Observer:
        """The observer."""
        widths, limit = read_initial_widths(self.widths0, None, model.p)
        L, gamma, x0 = innovation_gain(None, model), np.zeros(model.p), np.zeros(model.n)
        return build_branch_observer(model, sensor, L, gamma, x0, widths, limit, False)


@click.command()
def greet() -> int:
    """Say hello from another package."""
    click.echo("hello")
    return 0
'''
SCENARIO = """title = "mine"
sensor = { right = 0.5, left = 0.3, noise = 0.01 }
reference = { kind = "sine", amplitude = 2.0, frequency = 1.0 }
observer = { method = "held", widths0 = 0.4 }
controller = { method = "state_feedback", alpha = 5.0 }
simulation = { duration = 3.0, step = 0.01, time = "sampled" }
declared = { right = [0.0, 1.0] }

[plant]
A = [[-1.0]]
B = [[1.0]]
C = [[1.0]]

[ensemble]
runs = 20
"sensor.right" = { uniform = [0.4, 0.6] }
"""
Run = Callable[..., str]
PIP = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
OFFLINE = ["--no-deps", "--no-build-isolation", "--no-index"]


class Step(NamedTuple):
    """A step of the tutorial.

    Attributes:
        title: its heading.
        code: of its cells.
        files: its blocks of TOML.
        commands: that a reader types.
    """

    title: str
    code: str
    files: list[str]
    commands: list[str]


def read_steps() -> list[Step]:
    """Read the steps of the tutorial of an observer of one's own."""
    tutorial = (ROOT / "docs" / "tutorials" / "add_an_observer.py").read_text(encoding="utf-8")
    _, *sections = re.split(r"^# ## \d\. ", tutorial, flags=re.MULTILINE)
    steps = []
    for section in sections:
        title, _, body = section.partition("\n")
        cells = re.split(r"^# %%.*\n", body, flags=re.MULTILINE)
        code = "".join(cell for cell in cells[1:] if not cell.startswith("# "))
        prose = re.sub("^# ?", "", cells[0], flags=re.MULTILINE)
        files = re.findall(r"```toml\n(.*?)```", prose, re.DOTALL)
        steps.append(Step(title, code, files, re.findall(r"^\$ (.*)", prose, re.MULTILINE)))
    return steps


def register(site: Path, name: str, points: str) -> None:
    """Install the entry points of a package in a folder, all at once."""
    folder = site / f"{name}-new"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text(points)
    folder.rename(site / f"{name}-1.0.dist-info")


@pytest.fixture
def command(tmp_path: Path) -> Run:
    """Runs `undeadzone` where a package `mine` is installed beside it."""
    site = tmp_path / "site"
    (site / "mine").mkdir(parents=True)
    (site / "mine" / "__init__.py").write_text(OWN, encoding="utf-8")
    points = (
        "[undeadzone.observers]\nheld = mine:Held\nlost = nowhere:Lost\n"
        "[undeadzone.commands]\ngreet = mine:greet\n"
    )
    register(site, "mine", points)
    (tmp_path / "mine.toml").write_text(SCENARIO, encoding="utf-8")
    return command_beside(site, tmp_path)


def command_beside(site: Path, folder: Path) -> Run:
    """Return a function that runs `undeadzone` in a folder, beside what a site has installed."""
    before = os.environ.get("PYTHONPATH", "")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [str(site), before]))}

    def run(*arguments: str, code: int = 0) -> str:
        main = "from undeadzone.cli import main; main()"
        done = subprocess.run(
            [sys.executable, "-c", main, *arguments],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == code, done.stderr
        return done.stdout if code == 0 else done.stderr

    return run


def test_a_registered_observer_is_a_method_as_any_other(command: Run, tmp_path: Path) -> None:
    found = json.loads(command("run", "mine.toml", "--json", "--no-figures"))
    assert found["method"] == "held"
    assert found["d_right"] == pytest.approx(0.4)
    ensemble = json.loads(command("ensemble", "mine.toml", "--json", "--no-figures"))
    assert ensemble["runs"] == 20
    command("export", "mine.toml", "--to", "c", "--out", "fw")
    subprocess.run(["make", "-s", "-C", str(tmp_path / "fw"), "CC=gcc"], check=True)
    arena = ["arena", "mine.toml", "--methods", "held", "--seeds", "1", "--processes", "1"]
    rows = json.loads(command(*arena, "--json"))["leaderboard"]
    (row,) = [row for row in rows if row["method"] == "held"]
    assert 0 < row["median_regret"] < 10
    assert not row["reference"]


def test_the_recipe_and_the_tutorial_have_the_same_steps() -> None:
    recipe = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Add a method")[2]
    titles = re.findall(r"^\d\. \*\*(.+?)\.\*\*", recipe, re.MULTILINE)
    assert titles == [step.title for step in read_steps()]
    assert len(titles) == 5


def test_the_tutorial_makes_a_package_in_an_empty_folder(tmp_path: Path) -> None:
    """Its cells, its files and its commands, in the order in which a reader meets them."""
    equations, options, _, registration, use = read_steps()
    package, site = tmp_path / "package", tmp_path / "site"
    package.mkdir()
    (package / "fixed_width.py").write_text(equations.code + options.code, encoding="utf-8")
    (package / "pyproject.toml").write_text(*registration.files, encoding="utf-8")
    (package / "scenario.toml").write_text(*use.files, encoding="utf-8")
    install, run = (shlex.split(line) for line in use.commands)
    assert install == ["pip", "install", "."]
    target = ["--target", str(site)]
    subprocess.run([*PIP, *install[1:], *OFFLINE, *target], cwd=package, check=True)
    undeadzone, *arguments = run
    assert undeadzone == "undeadzone"
    found = json.loads(command_beside(site, package)(*arguments, "--json", "--no-figures"))
    assert found["method"] == "fixed_width"
    assert found["d_right"] == pytest.approx(0.7)


def test_a_registered_command_is_one_of_undeadzone(command: Run) -> None:
    assert command("greet") == "hello\n"
    assert "Say hello from another package." in command("--help")


def test_what_is_installed_meanwhile_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a notebook; what was found before is not read again."""
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("one", "other"):
        assert OBSERVERS.find_options(f"held_{name}") is None
        point = f"held_{name} = undeadzone.observers.oracle:Oracle\n"
        register(tmp_path, name, f"[undeadzone.observers]\n{point}")
        assert f"held_{name}" in OBSERVERS.list_tags()
    assert {"held_one", "held_other"} <= set(OBSERVERS.list_tags())


@pytest.mark.parametrize(
    ("observer", "words"),
    [
        (
            '"lost"',
            "'lost' is registered at nowhere:Lost, which fails: No module named 'nowhere'",
        ),
        ('"heldd"', "observer.method: unknown choice 'heldd'. Did you mean 'held'?"),
    ],
)
def test_a_method_that_is_not_there_is_reported(
    observer: str, words: str, command: Run, tmp_path: Path
) -> None:
    text = SCENARIO.replace('"held", widths0 = 0.4', observer)
    (tmp_path / "lost.toml").write_text(text, encoding="utf-8")
    assert words in command("run", "lost.toml", code=2)


def test_a_registered_name_is_one_of_uz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `uz.identify` and `uz.export` are, whose packages are no part of the tool."""
    monkeypatch.syspath_prepend(tmp_path)
    assert not hasattr(undeadzone, "root")
    register(tmp_path, "roots", "[undeadzone.names]\nroot = math:sqrt\nlost = nowhere:lost\n")
    assert undeadzone.root is math.sqrt
    with pytest.raises(undeadzone.InputError, match="lost is registered at nowhere:lost, which"):
        undeadzone.lost  # noqa: B018


def test_a_new_method_of_the_tool_is_one_file_and_one_line(tmp_path: Path) -> None:
    """Seen by the commands, the common tests, the page of the scenario file, the leaderboard."""
    for name in ("src", "docs", "tests"):
        left_out = shutil.ignore_patterns("*.egg-info")  # what is compiled need not be again
        shutil.copytree(ROOT / name, tmp_path / name, ignore=left_out)
    shutil.copy(ROOT / "README.md", tmp_path)
    tool = tmp_path / "src" / "undeadzone"
    (tool / "observers" / "held.py").write_text(OWN, encoding="utf-8")
    listed = (tool / "registry.py").read_text(encoding="utf-8")
    first = '        "auto": "undeadzone.observers.auto:Auto",\n'
    place = ":".join(["undeadzone.observers.held", "Held"])
    line = f'        "held": "{place}",\n'
    assert first in listed
    (tool / "registry.py").write_text(listed.replace(first, first + line), encoding="utf-8")
    (tmp_path / "mine.toml").write_text(SCENARIO, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "src")}

    def python(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        ).stdout

    main = "from undeadzone.cli import main; main()"
    run = python("-c", main, "run", "mine.toml", "--json", "--no-figures")
    assert json.loads(run)["method"] == "held"
    python("docs/reference.py")
    options = [page.read_text() for page in (tmp_path / "docs").glob("scenario*.md")]
    assert "**method** = 'held'" in "".join(options)
    collected = python(
        *("-m", "pytest", "-p", "no:cacheprovider", "--rootdir", str(tmp_path)),
        *("--collect-only", "-q"),
        *(
            "tests/undeadzone/compile/test_engines.py",
            "tests/undeadzone_arena/test_contest.py",
        ),
    )
    assert (
        "test_every_observer_and_controller_runs_the_same[held-state_feedback-sampled]" in collected
    )
    assert "test_every_method_runs_or_says_why_not[held]" in collected
