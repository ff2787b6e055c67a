"""Shell lines of the front page, and those that they print, run by a shell in a clean folder."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path

import pytest

from documents import ROOT
from further import further
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


# Files that readers have, by the pages that use them, and what makes each.
GIVEN = {
    "cp examples/samples.csv FILE": (
        *("log.csv", "first.csv", "second.csv", "samples.csv", "next_log.csv", "position.csv"),
    ),
    f"cp {ROOT}/docs/trades/valve.csv FILE": ("loop.csv",),
    f"cp {ROOT}/docs/trades/load_cell.csv FILE": ("load_cell.csv",),
    "cp examples/ur5.urdf FILE": ("robot.urdf",),
    "sed 's/step = 0.002/step = 0.01/' examples/pendulum.toml > FILE": ("pendulum.toml",),
    "undeadzone init --force FILE": ("mine.toml", "scenario.toml", "SCENARIO.toml", "s.toml"),
    "mkdir -p upload; cp examples/paper_5sin.toml FILE": ("upload/s.toml",),
    f"PYTHONPATH={ROOT}:$PYTHONPATH {sys.executable} -m benchmarks.end_to_end.cases FILE": (
        "logs/",
    ),
}
MADE = {  # logs that a line's options are for
    "y=acceleration": "sed 's/^t,y,u/time,acceleration,torque/' examples/samples.csv > log.csv",
    "--left inf": "awk -F, 'NR>1 && $2<0{$2=0}1' OFS=, examples/samples.csv > log.csv",
    "--kind jump": "awk -F, 'NR>1 && $2^2<1{$2=0}1' OFS=, examples/samples.csv > log.csv",
}
# Minutes to an hour: a robot, all methods with tuning. Words that stand for a reader's own choice.
OWN = re.compile(
    r"run examples/ur5|export examples/ur5|ensemble examples/ur5|ur5/|panda|\barena|\.\.\."
)
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.py"))
INLINE = re.compile(
    r"(?:`|[$] )(undeadzone \w+ [^`\n]*?(?:[\w/]+\.(?:toml|csv|urdf)|--example )[^`]*?)(?=`|$)",
    re.M,
)
HELP = {
    f"{path.parts[-2]}/{path.stem} --help": re.split(r", then look|; on W| && ", found[1])
    for path in sorted((ROOT / "src").rglob("*.py"))
    if (found := re.search(r'"Example: (.*)', path.read_text(encoding="utf-8")))
}


def read_lines(page: Path) -> list[str]:
    """The lines of a page's blocks and those inside its sentences, each once."""
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"```console.*?```", "", text, flags=re.S)  # test_docs.py runs these
    inside = re.sub(r"(?m)^# ", "", text) if page.suffix == ".py" else text
    found = [" ".join(line.split()) for line in INLINE.findall(inside)]
    return [*dict.fromkeys([*shell_lines(page), *found])]


SHOWN = {path.relative_to(ROOT).as_posix(): read_lines(path) for path in PAGES + TUTORIALS} | HELP
LINES = {
    name: [one for one in map(str.strip, lines) if re.match(r"(python -m )?undeadzone\w* \w", one)]
    for name, lines in SHOWN.items()
}
LINES = {
    name: [one.strip(' "),') for one in lines if not OWN.search(one)]
    for name, lines in LINES.items()
}
LINES = {name: lines for name, lines in LINES.items() if lines}
DRAWN = ("docs/export_plc.md", "cli/init --help", "cli/watch --help")


@pytest.mark.parametrize("page", [*DRAWN, *further(*(name for name in LINES if name not in DRAWN))])
def test_the_shell_lines_of_a_page_run(page: str, tmp_path: Path) -> None:
    """In one folder, in their order, with the files that a reader of the page has."""
    walk, lines = Walk(tmp_path), LINES[page]
    for make, names in GIVEN.items():
        for name in names:
            if re.search(rf"(?<![\w/]){name}\b", " ; ".join(lines)) and "init" not in lines[0]:
                walk.run(make.replace("FILE", name))
    for line in lines:
        for words, make in MADE.items():
            if words in line:
                walk.run(make)
        walk.run(line, highest=1)


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
