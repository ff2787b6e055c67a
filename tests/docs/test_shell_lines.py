"""Shell lines of the front page, and those that they print, run by a shell in a clean folder."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

import undeadzone
from commands import COMMAND
from documents import ROOT
from requirements import needs

pytestmark = needs("compiler", "bash", "gcc", "make")
BLOCK = re.compile(r"\n\n((?: {4}.*\n)+)")  # of four spaces, which Markdown shows as code
INSTALL = "pip install ."  # test_wheel.py runs what is installed
# A command inside a line that is printed, up to the words on what it does.
PRINTED = re.compile(r"(?:undeadzone|make) .*?(?=, |; | says | writes | builds |  # fits |$)", re.M)


class Reader(NamedTuple):
    """A folder in which a reader has run the front page.

    Attributes:
        folder: the folder.
        printed: output of each line that ran, in order.
    """

    folder: Path
    printed: dict[str, str]

    def run(self, line: str) -> str:
        """Run a line as it stands. It ends with exit code 0, and its output is returned."""
        here = {"PATH": f"{self.folder / 'bin'}{os.pathsep}{os.environ['PATH']}"}
        here["PYTHONPATH"] = str(Path(undeadzone.__file__).parents[1])
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=self.folder, env=os.environ | here, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        self.printed[line] = done.stdout
        return done.stdout


def shell_lines(page: Path) -> list[str]:
    """The lines of a page's blocks of four spaces."""
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [line.strip() for block in blocks for line in block.splitlines()]


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A folder with the examples of a checkout and the command, after all lines but the first."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "examples").symlink_to(ROOT / "examples")
    (folder / "bin").mkdir()
    command = folder / "bin" / "undeadzone"
    command.write_text(f'#!/bin/sh\nexec {shlex.join(COMMAND)} "$@"\n')
    command.chmod(0o755)
    found = Reader(folder, {})
    for line in shell_lines(ROOT / "README.md"):
        if not line.endswith(INSTALL):
            found.run(line)
    return found


def test_every_shell_line_of_the_front_page_ends_with_exit_code_0(reader: Reader) -> None:
    install, *others = shell_lines(ROOT / "README.md")
    assert install.endswith(INSTALL)
    assert list(reader.printed) == others
    assert [line.split()[1] for line in others] == ["identify", "run", "export"]
    _, _, exported = reader.printed.values()
    assert re.search(r"^double +float is not enough: ", exported, re.M)
    (lines,) = re.findall(r"```c\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    assert lines in re.sub(r"^ {11}", "", reader.printed[others[0]], flags=re.M)
    assert "REFUSED" not in exported


def test_the_commands_that_it_prints_run(reader: Reader) -> None:
    """An observer that is called leaner fits the boards that its line names, and no others."""
    before = {shlex.join(shlex.split(line, comments=True)) for line in reader.printed}
    printed = "\n".join(reader.printed.values())
    after = dict.fromkeys(line for line in PRINTED.findall(printed) if line not in before)
    subjects = [line.partition(" ")[2].split()[0] for line in after]
    assert {"estimate", "check", "export", "-C"} <= {*subjects}
    for line in after:
        reader.run(line)
    assert "every bit agrees" in reader.run("firmware/samples_test")
    leaner = re.findall(r"(undeadzone export .* --method \w+)  # fits (.*)", printed)
    assert len(leaner) == 2
    for line, boards in leaner:
        assert re.findall(r"^(\S.*?)  .*  yes$", reader.printed[line], re.M) == boards.split(", ")
