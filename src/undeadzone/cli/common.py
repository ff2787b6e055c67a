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
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from undeadzone.support.shown import Block
from undeadzone.support.shown import text as text_of
from undeadzone.support.text import printable

if TYPE_CHECKING:
    from undeadzone.report.html import Origin
    from undeadzone.results.info import LogInfo

Command = TypeVar("Command", bound=Callable[..., Any])
LARGE = 1e7  # [bytes] of a table of signals that is written unasked
SCHEMA = 1  # of JSON: raised when a key goes or changes its meaning; keys may be added
COLOURS = {"yes": "green", "ON TRUST": "yellow"}  # of verdicts; of others red
# Where a cell begins, or after what is judged: right yes, left NO.
VERDICT = re.compile(
    r"(?:(?<=  )|(?<=: )|(?<=right )|(?<=left )|(?<=width )|(?<=centre ))"
    r"(?:yes|NO|ON TRUST|LEFT|never settles|at the end of its range)\b"
    r"|^(?:DIVERGED|NOT EXACT|REFUSED|NO)\b"
)


def common(command: Command) -> Command:
    """Add --out, --json and --no-figures."""
    no_figures = click.option("--no-figures", is_flag=True, help="Compute only; draw nothing.")
    as_json = click.option(
        "--json",
        "as_json",
        is_flag=True,
        help="Print one JSON object on stdout and nothing else there.",
    )
    out = click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=None,
        metavar="DIR",
        help="Folder for the files written (made if missing).",
    )
    return out(as_json(no_figures(command)))


def csv_option(command: Command) -> Command:
    """Add --csv."""
    words = f"Write the table of signals too where it is larger than {LARGE / 1e6:g} MB."
    return click.option("--csv", "as_csv", is_flag=True, help=words)(command)


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


def confined(command: Command) -> Command:
    """Add --confine."""
    option = click.option(
        "--confine",
        type=click.Path(path_type=Path),
        default=None,
        metavar="DIR",
        help="Refuse files that the scenario names outside of DIR, as a service should.",
    )
    return option(command)


def force_option(command: Command) -> Command:
    """Add --force."""
    words = "Replace what someone else wrote or edited."
    return click.option("--force", is_flag=True, help=words)(command)


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


def folder_for(out: Path | None, no_figures: bool, default: str) -> Path | None:
    """The folder for the files written; None: nothing is written.

    Called before the computation, so that a folder in which nothing can be written is noticed then.

    Args:
        out: what --out says.
        no_figures: whether --no-figures is given.
        default: name of the folder without --out.

    Raises:
        FileError: nothing can be written there.
    """
    if out is None and no_figures:
        return None
    folder = writable(Path(default) if out is None else out)
    if not no_figures:
        prepare_figures()
    return folder


def prepare_figures() -> None:
    """Let figures look the same in every folder; called before the first is drawn."""
    from undeadzone.report.style import own_settings

    own_settings()


def writable(folder: Path) -> Path:
    """The folder. Raises FileError where nothing can be written."""
    from undeadzone.support.files import require_folder

    require_folder(folder)
    return folder


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


def strict_option(command: Command) -> Command:
    """Add --strict."""
    return click.option(
        "--strict", is_flag=True, help="Stop at the first line that cannot be read."
    )(command)


def columns_option(command: Command) -> Command:
    """Add --columns."""
    return click.option(
        "--columns",
        default=None,
        metavar="y=NAME,u=NAME",
        help="Columns by name or number: t=1,y=angle,u=voltage; several: y[0]=a,y[1]=b.",
    )(command)


def exit_code(info: LogInfo) -> int:
    """1 where the record is not consistent, else 0."""
    return 1 if info.consistent is False else 0
