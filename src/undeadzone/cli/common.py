"""What the commands share: options, the progress bar, printing of numbers, tables of logs."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import reduce, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from undeadzone.support.shown import Block
from undeadzone.support.shown import text as text_of
from undeadzone.support.text import printable

if TYPE_CHECKING:
    from undeadzone.report.html import Origin
    from undeadzone.results.info import LogInfo

LARGE = 1e7  # [bytes] of a table of signals that is written unasked
SCHEMA = 1  # of JSON: raised when a key goes or changes its meaning; keys may be added
COLOURS = {"yes": "green", "ON TRUST": "yellow"}  # of verdicts; of others red
# Where a cell begins, or after what is judged: right yes, left NO.
VERDICT = re.compile(
    r"(?:(?<=  )|(?<=: )|(?<=right )|(?<=left )|(?<=width )|(?<=centre ))"
    r"(?:yes|NO|ON TRUST|LEFT|never settles|at the end of its range)\b"
    r"|^(?:DIVERGED|NOT EXACT|REFUSED|NO)\b"
)


PATH = click.Path(path_type=Path)

# Options that several commands have
csv_option = click.option(
    "--csv",
    "as_csv",
    is_flag=True,
    help=f"Write the table of signals too where it is larger than {LARGE / 1e6:g} MB.",
)
confined = click.option(
    "--confine",
    type=PATH,
    metavar="DIR",
    help="Refuse files that the scenario names outside of DIR, as a service should.",
)
strict_option = click.option(
    "--strict", is_flag=True, help="Stop at the first line that cannot be read."
)
columns_option = click.option(
    "--columns",
    metavar="y=NAME,u=NAME",
    help="Columns by name or number: t=1,y=angle,u=voltage; several: y[0]=a,y[1]=b.",
)
OUTPUTS = (
    click.option("--no-figures", is_flag=True, help="Compute only; draw nothing."),
    click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print one JSON object on stdout and nothing else there.",
    ),
    click.option(
        "--out",
        type=PATH,
        metavar="DIR",
        help="Folder for the files written (made if missing).",
    ),
)


class Output(NamedTuple):
    """What a command does with its result.

    Attributes:
        out: folder that --out names; None: the command's own.
        as_json: whether one JSON object is printed.
        figures: whether figures and a page are drawn.
    """

    out: Path | None
    as_json: bool
    figures: bool

    def folder(self, default: str) -> Path | None:
        """The folder for the files written; None: nothing is written.

        Called before the computation, so that a folder in which nothing can be written is noticed
        then.

        Args:
            default: name of the folder without --out.

        Raises:
            FileError: nothing can be written there.
        """
        if self.out is None and not self.figures:
            return None
        folder = writable(self.out or Path(default))
        if self.figures:
            prepare_figures()
        return folder

    def show(
        self,
        numbers: Callable[[], Mapping[str, Any]],
        blocks: Callable[[], Sequence[Block]],
        written: Sequence[Path],
        last: Mapping[str, Any] | None = None,
    ) -> None:
        """Print a result as one JSON object, or in words.

        Args:
            numbers: gives the object.
            blocks: gives the words.
            written: the files.
            last: lines at the end of the words; None: those that name the files.
        """
        if self.as_json:
            print_json(numbers(), written)
        else:
            print_blocks(blocks(), named_files(written) if last is None else last)


def common(command: Callable[..., int]) -> Callable[..., int]:
    """Add --out, --json and --no-figures, which the command gets as one `Output`."""

    @wraps(command)
    def given(out: Path | None, as_json: bool, no_figures: bool, **options: Any) -> int:
        return command(output=Output(out, as_json, not no_figures), **options)

    return reduce(lambda made, option: option(made), OUTPUTS, given)


def wanted_table(as_csv: bool, size: float, name: str) -> tuple[bool, dict[str, str]]:
    """Whether a table of signals is written, and else the line that says so.

    Args:
        as_csv: whether --csv is given.
        size: of the table [bytes].
        name: of its file.
    """
    if as_csv or size <= LARGE:
        return True, {}
    return False, {"left out": f"{name}, about {size / 1e6:.0f} MB: --csv writes it"}


def origin(path: Path | None, seed: int | None = None) -> Origin:
    """What it takes to get a result again, for its page: the command, and the scenario as given.

    Args:
        path: of the scenario; None: there is none.
        seed: of every random number; None: there is none, or several.
    """
    from undeadzone.report.html import Origin
    from undeadzone.support.files import read_text

    text = ""
    if path is not None:
        with suppress(OSError, ValueError):  # it was there when the command began
            text = read_text(path)
    return Origin(shlex.join(["undeadzone", *sys.argv[1:]]), text, seed)


def prepare_figures() -> None:
    """Let figures look the same in every folder; called before the first is drawn."""
    from undeadzone.report.style import own_settings

    own_settings()


def writable(folder: Path) -> Path:
    """The folder. Raises FileError where nothing can be written."""
    from undeadzone.support.files import require_folder

    require_folder(folder)
    return folder


def partial_file(folder: Path | None, name: str, resume: bool) -> Path | None:
    """Where a search is kept until it is done; None: nowhere.

    Args:
        folder: of what it writes; None: it writes nothing.
        name: of the file that it writes at its end.
        resume: whether --resume is given.

    Raises:
        click.UsageError: there is nothing to resume.
    """
    if folder is not None:
        return folder / f"{name}.partial"
    if resume:
        raise click.UsageError("--resume needs the folder that was written to; name it with --out")
    return None


def named_files(written: Sequence[Path]) -> dict[str, Any]:
    """The line that names the files written, for `print_blocks`; nothing where there are none."""
    return {"written": ", ".join(map(str, written))} if written else {}


def print_json(value: Mapping[str, Any], written: Sequence[Path] | None = None) -> None:
    """One JSON object on stdout, which begins with the version of its schema (docs/json.md).

    Args:
        value: the result.
        written: files, that are named at its end; None: the command writes none.
    """
    files = {} if written is None else {"files": [str(path) for path in written]}
    click.echo(json_text(with_schema(value) | files))


def with_schema(value: Mapping[str, Any]) -> dict[str, Any]:
    """A result under the version of its schema."""
    return {"schema": SCHEMA, **value}


def say(text: str = "", err: bool = False) -> None:
    """One line on stdout, or stderr, whatever characters a scenario put into it."""
    click.echo(printable(text), err=err)


def json_text(value: Any) -> str:
    """A value as JSON; numbers that are not finite become null."""
    from undeadzone.support.arrays import finite

    return json.dumps(finite(value), indent=2, allow_nan=False)


def print_blocks(
    blocks: Sequence[Block], last: Mapping[str, Any] | None = None, err: bool = False
) -> None:
    """Blocks of a result, an empty line between them: folded and coloured on a terminal.

    Args:
        blocks: what is printed.
        last: lines `name  value` at the end.
        err: whether they go to stderr.
    """
    if last:
        *before, end = blocks
        joined = [{**end, **last}] if isinstance(end, Mapping) else [end, last]
        blocks = [*before, *joined]
    stream = sys.stderr if err else sys.stdout
    if not stream.isatty():
        click.echo(text_of(blocks), err=err)
        return
    text = text_of(blocks, shutil.get_terminal_size().columns)
    click.echo(painted(text) if _coloured() else text, err=err)


def painted(text: str) -> str:
    """A text whose verdicts are coloured; the lines that name a scenario stay as they are."""
    lines = []
    for line in text.split("\n"):
        lines.append(line if line.startswith("scenario") else VERDICT.sub(_paint, line))
    return "\n".join(lines)


def _paint(found: re.Match[str]) -> str:
    """A verdict in its colour."""
    return click.style(found[0], fg=COLOURS.get(found[0], "red"), bold=True)


def _coloured() -> bool:
    """Whether colours are wanted (no-color.org)."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def exit_code(info: LogInfo) -> int:
    """1 where the record is not consistent, else 0."""
    return 1 if info.consistent is False else 0
