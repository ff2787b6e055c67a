"""Shared parts of the commands: options, folders, printing of numbers and text."""

from __future__ import annotations

import errno
import functools
import itertools
import json
import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from undeadzone.errors import InputError
from undeadzone.util.files import SCHEMA as SCHEMA
from undeadzone.util.files import convert_write_errors, read_text, require_folder
from undeadzone.util.opening import bind_folder, require_beneath
from undeadzone.util.shown import Block
from undeadzone.util.shown import format_blocks as text_of
from undeadzone.util.text import escape_controls

if TYPE_CHECKING:
    from undeadzone.report.html import Origin

Command = TypeVar("Command", bound=Callable[..., Any])
COLOURS = {"yes": "green", "OPEN LOOP": "yellow"}  # of verdicts; of others red
# At the start of a cell, or behind the judged quantity: right yes, left NO.
VERDICT = re.compile(
    r"(?:(?<=  )|(?<=: )|(?<=right )|(?<=left )|(?<=width )|(?<=centre ))"
    r"(?:yes|NO|OPEN LOOP|LEFT|never settles|at the end of its range)\b"
    r"|^(?:DIVERGED|NOT EXACT|REFUSED|NO)\b"
)


class UserPath(click.Path):
    """Path of a file or a folder that a user names. Refuses the empty string, which means the
    current folder.

    Args:
        use: use of the path (`--untrusted` and docs/security.md go by it).
        files: endings of files, which a folder that is still to be made has not.
    """

    def __init__(self, use: str, files: tuple[str, ...] = ()) -> None:
        super().__init__(path_type=Path)
        self.use, self.files = use, files

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path. Raises BadParameter if the name is empty, or none on this system."""
        if value == "":
            self.fail("the name is empty. The folder in which you are is '.'", param, ctx)
        try:
            os.lstat(value)
        except OSError as error:
            if error.errno == errno.ENAMETOOLONG:
                self.fail("the name is longer than this system allows", param, ctx)
            if str(value).endswith(self.files):
                self.fail(f"{value} is a file's name. Name the folder for the files", param, ctx)
        return super().convert(value, param, ctx)


READ = UserPath("read")
WRITTEN = UserPath("written")
WRITTEN_FOLDER = UserPath("written", (".toml", ".csv", ".json", ".npz", ".html", ".svg"))
READ_AND_WRITTEN = UserPath("read and written")
LIMIT = UserPath("limit")


def value_option(
    name: str, metavar: str | None, words: str, *into: str, **more: Any
) -> Callable[..., Any]:
    """Return an option with a value (into: its argument, if renamed, more: keywords of click)."""
    return click.option(name, *into, metavar=metavar, help=words, **more)


def flag_option(name: str, words: str, *into: str, **more: Any) -> Callable[..., Any]:
    """Return an option without a value (into: its argument if renamed, more: keywords of click)."""
    return click.option(name, *into, is_flag=True, help=words, **more)


class SubjectCommand(click.Command):
    """Command whose help shows a few options, and with --help-all every option by subject.

    Attributes:
        subjects: names of options by title. `--help` shows the first title alone.
    """

    subjects: Mapping[str, Sequence[str]]

    def __init__(self, *args: Any, subjects: Mapping[str, Sequence[str]], **more: Any) -> None:
        super().__init__(*args, **more)
        self.subjects = subjects

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of the first subject, or of all subjects."""
        records = {each.opts[-1]: each.get_help_record(ctx) for each in self.get_params(ctx)}
        displayed = (
            self.subjects if ctx.meta.get(ALL_OPTIONS) else dict([*self.subjects.items()][:1])
        )
        for title, names in displayed.items():
            with formatter.section(title):
                formatter.write_dl([record for name in names if (record := records[name])])


ALL_OPTIONS = "undeadzone.all_options"  # key of a context in which --help-all stands


def _print_full_help(context: click.Context, _: click.Parameter, is_requested: bool) -> None:
    """Print the help with every option, and exit."""
    if is_requested:
        context.meta[ALL_OPTIONS] = True
        click.echo(context.get_help())
        context.exit()


# Options that several commands have
help_all = flag_option(
    "--help-all",
    "Show all options by subject, and exit.",
    is_eager=True,
    expose_value=False,
    callback=_print_full_help,
)
_confined = value_option(
    "--confine",
    "DIR",
    "Refuse files that the scenario names outside of DIR, as a service should.",
    type=LIMIT,
)
force_option = flag_option("--force", "Replace files that others wrote or edited.")
strict_option = flag_option("--strict", "Stop at the first line that cannot be read.")
columns_option = value_option(
    "--columns",
    "y=NAME,u=NAME",
    "Columns by name or number: t=1,y=angle,u=voltage, and several as y[0]=a,y[1]=b.",
)


def add_untrusted(command: Command) -> Command:
    """Add --untrusted, which restricts the process until its end and implies --confine."""

    @functools.wraps(command)
    def run_confined(*, untrusted: Path | None, **options: Any) -> Any:
        """Run the command, in a restricted process if --untrusted is given."""
        if untrusted is None:
            return command(**options)
        from undeadzone.cli.untrusted import restrict_process

        if options.get("out", untrusted) is None and not options.get("no_figures"):
            raise InputError(
                "--untrusted: --out is missing. Give it: it is the only folder that is written"
            )
        _bind_process(untrusted, options)
        with ExitStack() as ending:
            for word in restrict_process(untrusted, _output_folder(options), ending):
                print_line(f"untrusted: {word}", err=True)
            if "confine" in options:
                options["confine"] = untrusted
            return command(**options)

    return value_option(
        "--untrusted",
        "DIR",
        "Treat DIR as hostile: read only DIR, write only --out, limit time and memory.",
        type=LIMIT,
    )(run_confined)


def _bind_process(folder: Path, options: Mapping[str, Any]) -> None:
    """Bind this process to a stranger's folder.

    Files to read are checked as they are opened, files to write are checked here.

    Raises:
        InputError: `folder` is not a folder.
        FileError: a path to be written begins in `folder`, and leads out of it.
    """
    if not folder.is_dir():
        raise InputError(f"--untrusted: expected a folder, found {str(folder)!r}")
    bind_folder(folder)
    for parameter in click.get_current_context().command.params:
        path = options.get(parameter.name or "")
        if isinstance(parameter.type, UserPath) and "written" in parameter.type.use and path:
            with convert_write_errors(path):
                require_beneath(path)


def add_guards(command: Command) -> Command:
    """Add --untrusted and --confine: a scenario names files, and may be a stranger's."""
    return add_untrusted(_confined(name_file_in_errors(command)))


def name_file_in_errors(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return the command with errors that name the file of the wrong key or log.

    The readers of files name them. Errors found later, such as a value that does not fit, know only
    the key.
    """

    @functools.wraps(command)
    def run_with_file_name(**options: Any) -> Any:
        """Run the command. An InputError names the file."""
        try:
            return command(**options)
        except InputError as error:
            raise type(error)(_prefix_file(str(error), options)) from None

    return run_with_file_name


def _prefix_file(message: str, options: Mapping[str, Any]) -> str:
    """Return a message that begins with the scenario, or the logs, in error."""
    from undeadzone.scenario.schema import Scenario

    first = re.split(r"\W", message, maxsplit=1)[0]
    scenario = options.get("scenario")
    if scenario is not None and first in Scenario.__struct_fields__:
        return f"{scenario}: {message}"
    if "logs" in options and message.startswith("log: "):
        return f"{', '.join(map(str, options['logs']))}: {message.removeprefix('log: ')}"
    return message


def _output_folder(options: Mapping[str, Any]) -> Path | None:
    """Return the folder that a command may write: --out, or the folder of its only file."""
    out = options.get("out")
    state = options.get("state")
    file = out if options.get("to") == "page" else state
    folder: Path | None = out if file is None else file.parent
    return folder


def build_origin(path: Path | None, seed: int | None = None) -> Origin:
    """Return the origin of a result for its page: the command, and the scenario as given.

    Args:
        path: of the scenario (None: there is none).
        seed: of every random number (None: there is none, or several).
    """
    from undeadzone.report.html import Origin

    text = ""
    if path is not None:
        with suppress(OSError, ValueError):  # it was there when the command began
            text = read_text(path)
    return Origin(typed_command(), text, seed)


def typed_command(*words: str) -> str:
    """Return the command that runs, with more words, as text for a shell."""
    return shell_command("undeadzone", *sys.argv[1:], *words)


def shell_command(*words: object, **options: object) -> str:
    """Return a command as text for a shell, with those options that have a value, quoted."""
    given = [(f"--{name}", value) for name, value in options.items() if value]
    return shlex.join(map(str, itertools.chain(words, *given)))


def require_writable(folder: Path) -> Path:
    """Return the folder. Raises FileError if it is not writable."""
    require_folder(folder)
    return folder


def print_json(value: Mapping[str, Any], written: Sequence[Path] | None = None) -> None:
    """Print a JSON object on stdout, beginning with the version of its schema (docs/json.md).

    Args:
        value: the result.
        written: files, that are named at its end (None: the command writes none).
    """
    files = {} if written is None else {"files": list(map(str, written))}
    click.echo(to_json_text(add_schema(value) | files))


def add_schema(value: Mapping[str, Any]) -> dict[str, Any]:
    """Return a result under the version of its schema."""
    return {"schema": SCHEMA, **value}


def print_line(text: str = "", err: bool = False) -> None:
    """Print a line on stdout, or stderr, with the control characters of a scenario escaped."""
    click.echo(escape_controls(text), err=err)


def to_json_text(value: Any) -> str:
    """Return a value as JSON. Numbers that are not finite become null."""
    from undeadzone.util.arrays import to_json_value

    return json.dumps(to_json_value(value), indent=2, allow_nan=False)


def print_blocks(
    blocks: Sequence[Block], last: Mapping[str, Any] | None = None, err: bool = False
) -> None:
    """Print the blocks of a result, separated by empty lines: folded and coloured on a
    terminal.

    Args:
        blocks: parts of the text.
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
    click.echo(paint_verdicts(text) if _wants_colour() else text, err=err)


def paint_verdicts(text: str) -> str:
    """Return a text with coloured verdicts. Lines that name a scenario stay unchanged."""
    lines = []
    for line in text.split("\n"):
        lines.append(line if line.startswith("scenario") else VERDICT.sub(_paint_verdict, line))
    return "\n".join(lines)


def _paint_verdict(found: re.Match[str]) -> str:
    """Return a verdict in its colour."""
    return click.style(found[0], fg=COLOURS.get(found[0], "red"), bold=True)


def _wants_colour() -> bool:
    """Return whether colours are wanted (no-color.org)."""
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
