"""What people see of the command line: folded lines, colours, completion, what is left out."""

from __future__ import annotations

import functools
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from fcntl import ioctl
from pathlib import Path

import pytest

from commands import COMMAND, undeadzone
from documents import ROOT
from undeadzone.cli.common import paint_verdicts
from undeadzone.cli.output import LARGE, decide_table
from undeadzone.cli.watch import watch
from undeadzone.util import shown
from undeadzone_identify.command import identify

COLOUR = re.compile(r"\x1b\[[0-9;]*m")
TWO = ["run", "examples/two_outputs.toml", "--no-figures"]


@functools.cache
def on_terminal(columns: int, **variables: str) -> str:
    """What the command `TWO` shows on a terminal of so many columns."""
    ours, its = pty.openpty()
    ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    plain = {name: value for name, value in os.environ.items() if name not in REMOVED}
    with subprocess.Popen(
        [*COMMAND, *TWO],
        stdout=its,
        stderr=subprocess.DEVNULL,
        stdin=its,
        cwd=ROOT,
        env=plain | variables,
    ) as process:
        os.close(its)
        displayed = b""
        while piece := _read(ours):
            displayed += piece
        process.wait(60)
    os.close(ours)
    return displayed.decode().replace("\r\n", "\n")


REMOVED = ("NO_COLOR", "COLUMNS", "LINES", "TERM", "JPY_PARENT_PID")


def _read(handle: int) -> bytes:
    """What comes next; nothing once the other end is closed."""
    try:
        return os.read(handle, 1 << 16)
    except OSError:
        return b""


@pytest.mark.parametrize("columns", [40, 80, 200])
def test_lines_fit_the_terminal(columns: int) -> None:
    text = COLOUR.sub("", on_terminal(columns, TERM="xterm"))
    lines = text.splitlines()
    assert max(map(len, lines)) <= columns
    assert "Two outputs, four widths" in text
    tables = [line for line in lines if re.match(r"output +rms z - r", line)]
    assert len(tables) == (columns > 40)  # narrow ones have a line for each cell
    assert text.count("1.133e-06") == 1


def test_verdicts_have_colours_on_terminals_alone() -> None:
    assert "\x1b[32m" in on_terminal(200, TERM="xterm")
    for variables in ({"TERM": "xterm", "NO_COLOR": "1"}, {"TERM": "dumb"}):
        assert "\x1b" not in on_terminal(200, **variables)
    piped = undeadzone(*TWO, cwd=ROOT).stdout
    assert "\x1b" not in piped
    assert COLOUR.sub("", on_terminal(200, TERM="xterm")) == piped


def test_what_is_painted() -> None:
    text = "scenario   NO names\ncertified  NO: why\nmargin     yes, right NO, left yes\nis NO word"
    lines = paint_verdicts(text).splitlines()
    assert lines[0] == "scenario   NO names"
    assert lines[1].count("\x1b[31m") == 1
    assert (lines[2].count("\x1b[32m"), lines[2].count("\x1b[31m")) == (2, 1)
    assert lines[3] == "is NO word"


def test_tables_fold_to_records() -> None:
    rows = [("output", "value"), ("q1", "right yes"), ("q2", "")]
    assert shown.format_blocks([rows], 80).splitlines()[0] == "output  value"
    assert shown.format_blocks([rows], 12) == "output  q1\nvalue   right yes\n\noutput  q2"
    folded = shown.format_blocks(
        [{"a": "one two three four five six seven eight"}], 30
    ).splitlines()
    assert folded == ["a  one two three four five six", "   seven eight"]


@pytest.mark.parametrize(
    ("words", "number", "found"),
    [
        ("undeadzone e", 1, {"ensemble", "estimate", "export"}),
        ("undeadzone run --no", 2, {"--no-figures"}),
        ("undeadzone design mine.toml --maximise k", 4, {"knee"}),
    ],
)
def test_shells_complete(words: str, number: int, found: set[str]) -> None:
    completion = {
        "_UNDEADZONE_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(number),
    }
    program = Path(sys.executable).with_name("undeadzone")
    done = subprocess.run(
        [program], env=os.environ | completion, capture_output=True, text=True, check=False
    )
    assert {line.partition(",")[2] for line in done.stdout.split()} == found


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_page_names_the_completion_settings_of_shells(shell: str) -> None:
    page = (ROOT / "docs/command_line.md").read_text(encoding="utf-8")
    assert f"_UNDEADZONE_COMPLETE={shell}_source undeadzone" in page
    program = Path(sys.executable).with_name("undeadzone")
    completed = subprocess.run(
        [program],
        env=os.environ | {"_UNDEADZONE_COMPLETE": f"{shell}_source"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "_UNDEADZONE_COMPLETE" in completed.stdout


def test_large_tables_are_left_out_and_named() -> None:
    assert decide_table(False, LARGE, "run.csv") == (True, {})
    assert decide_table(True, 10 * LARGE, "run.csv") == (True, {})
    is_decided, line = decide_table(False, 2.4e7, "run.csv")
    assert not is_decided
    assert line == {"left out": "run.csv, about 24 MB: --csv writes it"}


def test_a_long_run_says_what_it_left_out(tmp_path: Path) -> None:
    text = (ROOT / "examples/asymmetric_noise.toml").read_text()
    path = tmp_path / "long.toml"
    path.write_text(text.replace("duration = 30.0", "duration = 400.0"))
    for more, files in (([], {"run.npz"}), (["--csv"], {"run.npz", "run.csv"})):
        out = tmp_path / f"out{len(more)}"
        done = undeadzone("run", path, "--no-figures", "--out", out, *more)
        assert {file.name for file in out.iterdir()} == files
        assert ("--csv writes it" in done.stdout) == (not more)


def test_no_example_needs_a_shell_of_unix() -> None:
    assert "type samples.csv |" in str(watch.epilog)
    assert "<" not in str(identify.epilog)
