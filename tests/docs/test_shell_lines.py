"""Shell lines of the front page, and those that they print, run by a shell in a clean folder."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from documents import ROOT
from requirements import needs
from walks import Walk, commands_in

pytestmark = needs("compiler", "bash", "gcc", "make")
BLOCK = re.compile(r"\n\n((?: {4}.*\n)+)")  # of four spaces, which Markdown shows as code
INSTALL = "pip install ."  # test_wheel.py runs what is installed


def shell_lines(page: Path) -> list[str]:
    """The lines of a page's blocks of four spaces."""
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [line.strip() for block in blocks for line in block.splitlines()]


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    """A folder with the examples of a checkout and the command, after all lines but the first."""
    found = Walk(tmp_path_factory.mktemp("reader"))
    for line in shell_lines(ROOT / "README.md"):
        if not line.endswith(INSTALL):
            found.run(line)
    return found


def test_every_shell_line_of_the_front_page_ends_with_exit_code_0(reader: Walk) -> None:
    install, *others = shell_lines(ROOT / "README.md")
    assert install.endswith(INSTALL)
    assert list(reader.printed) == others
    assert [line.split()[1] for line in others] == ["identify", "run", "export"]
    _, _, exported = reader.printed.values()
    assert re.search(r"^double +float is not enough: ", exported, re.M)
    (lines,) = re.findall(r"```c\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)
    assert lines in re.sub(r"^ {11}", "", reader.printed[others[0]], flags=re.M)
    assert "REFUSED" not in exported


def test_the_commands_that_it_prints_run(reader: Walk) -> None:
    """An observer that is called leaner fits the boards that its line names, and no others."""
    before = {shlex.join(shlex.split(line, comments=True)) for line in reader.printed}
    printed = "\n".join(reader.printed.values())
    after = dict.fromkeys(line for line in commands_in(printed) if line not in before)
    subjects = [line.partition(" ")[2].split()[0] for line in after]
    assert {"estimate", "check", "export", "-C"} <= {*subjects}
    for line in after:
        reader.run(line)
    assert "every bit agrees" in reader.run("firmware/samples_test")
    leaner = re.findall(r"(undeadzone export .* --method \w+)  # fits (.*)", printed)
    assert len(leaner) == 2
    for line, boards in leaner:
        assert re.findall(r"^(\S.*?)  .*  yes$", reader.printed[line], re.M) == boards.split(", ")
